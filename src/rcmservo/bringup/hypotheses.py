"""Hypotheses about one error in a rig file, each fitted to the observations.

A hypothesis assigns axes to joints, reverses joints, mirrors the image and corrects at most one
number of the arm. The joints qⱼ follow from the reported joints q̃ and the file's counts c by

    qⱼ = q₀ⱼ + σⱼ fⱼ (cₖ/cⱼ) (q̃ₖ − q̃₀ₖ)

k is the index of the axis that drives joint j, σⱼ = −1 for a reversed joint, fⱼ a factor on its
motion, and q₀ = q̃₀ the joints at the first pose. The image of small motions identifies the sign of
the insertion and, as far as a camera allows, the factors f, the zero of the insertion and the
spacing of the markers. A mirrored image or one reversed angle look the same, so that the image
identifies only whether the number of these reversals is even or odd.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from rcmservo.bringup.axis_wiring import Order, Robot, Wiring
from rcmservo.bringup.identification import (
    SPACING,
    ZERO,
    MarkerViews,
    compute_corrected_markers,
    identify,
)
from rcmservo.interfaces import Floats

INSERTION_COUNTS = 2
"""Index of the correction of the insertion's counts."""

USUAL_FACTORS = 2.0, 4.0, 10.0, 25.4, 180.0 / np.pi, 2.0 * np.pi, 1000.0
"""Common errors in counts: edges of an encoder (2, 4), decimals, inches, degrees, turns, metres."""
FACTOR_TOLERANCE = 0.04
"""Tolerance on the logarithm of a fitted factor: within it, the usual factor replaces it."""
FACTOR_DEVIATIONS, MAX_FACTOR_TOLERANCE = 3.0, 0.3
"""Tolerance in standard deviations of the logarithm, and its upper bound; replaces
`FACTOR_TOLERANCE` where it is larger."""
UNUSUAL_PENALTY = 12.0
"""Misfit (squared standard deviations) added for a factor that is none of `USUAL_FACTORS`."""
MIN_INITIAL_LOG_FACTOR = 1.5
"""Logarithm of the apparent factor beyond which the search starts at that factor, not at 1."""

MAX_MISFIT_DIFFERENCE = 25.0
"""Difference of misfit (squared standard deviations) up to which two hypotheses explain the image
equally well."""
MAX_MEAN_SQUARE = 4.0
"""Mean square of the normalised residuals beyond which a hypothesis is rejected."""


@dataclass(frozen=True)
class Hypothesis:
    """A possible error in the rig file, or none.

    Parameters
    ----------
    order : Order
        Indices of the axes in the file that drive joints 1, 2 and 3.
    reversed : tuple[bool, bool, bool]
        True for each joint that moves in the direction opposite to its counts.
    mirrored : bool
        True if the image is mirrored.
    number : int or None
        Index of the number to correct: 0 to 2 for the counts of joints 1 to 3, `ZERO` or
        `SPACING`; None for no correction.
    size : float
        Correction of that number: the logarithm of a factor, or mm for `ZERO`.
    deviation : float
        Standard deviation of `size`; 0 before a fit.
    misfit : float
        Sum of the squared residuals in standard deviations; 0 before a fit.
    """

    order: Order = (0, 1, 2)
    reversed: tuple[bool, bool, bool] = (False, False, False)
    mirrored: bool = False
    number: int | None = None
    size: float = 0.0
    deviation: float = field(default=0.0, compare=False)
    misfit: float = field(default=0.0, compare=False)

    @property
    def corrects_counts(self) -> bool:
        """True if the hypothesis corrects the counts of a joint."""
        return self.number is not None and self.number < ZERO

    @property
    def is_odd(self) -> bool:
        """True if the number of reversals (mirror, two angles) is odd; an image identifies this."""
        return (self.mirrored + self.reversed[0] + self.reversed[1]) % 2 == 1

    @property
    def counts_factors(self) -> Floats:
        """Factors (3,) that correct the counts of the file."""
        signs = np.where(self.reversed, -1.0, 1.0)
        return signs * np.exp(-self.correction[:ZERO])

    @property
    def correction(self) -> Floats:
        """Corrections (5,) in the order of `CORRECTION_PRIOR`."""
        return np.where(np.arange(5) == self.number, self.size, 0.0)

    def predict_moving_joint(self, joint: int, wiring: Wiring) -> tuple[int, int]:
        """Return the joint that moves, and its sign (±1), if `joint` is commanded upwards."""
        moving, counts = self.order.index(joint), wiring.counts
        is_upwards = (counts[joint] / counts[moving] > 0.0) != self.reversed[moving]
        return moving, 1 if is_upwards else -1

    def compute_joints(self, wiring: Wiring, q: Floats) -> Floats:
        """Return the joints (n, 3) from the reported `q` (n, 3): the equation above with f = 1."""
        c, order = np.array(wiring.counts), list(self.order)
        signs = np.where(self.reversed, -1.0, 1.0)
        return q[0] + (q - q[0])[:, order] * c[order] / c * signs

    def compute_markers(self, robot: Robot, q: Floats) -> Floats:
        """Return the markers (n, 2, 3) in mm for the reported joints `q` (n, 3)."""
        joints = self.compute_joints(robot.wiring, q)
        return compute_corrected_markers(robot.mechanism, robot.tool, joints, self.correction)

    def compute_travel(self, robot: Robot, q: Floats, joint: int, motion: float) -> float:
        """Return the travel of marker 2 in mm for a `motion` (rad or mm) of a joint from q (3,)."""
        start_and_end = np.stack([q, q])
        start_and_end[1, joint] += motion
        travel: Floats = np.diff(self.compute_markers(robot, start_and_end)[:, 1], axis=0)
        return float(np.linalg.norm(travel))

    def explains(self, views: MarkerViews) -> bool:
        """Return whether noise and lens distortion can cause the residuals."""
        return self.misfit < MAX_MEAN_SQUARE * views.points.size

    def is_close(self, best: "Hypothesis") -> bool:
        """Return whether the misfit is within `MAX_MISFIT_DIFFERENCE` of that of the best fit."""
        return self.misfit < best.misfit + MAX_MISFIT_DIFFERENCE

    @property
    def undetectable(self) -> float:
        """Largest error of its number that would remain undetected, in the unit of `size`."""
        penalty = UNUSUAL_PENALTY if self.corrects_counts else 0.0
        return self.deviation * float(np.sqrt(MAX_MISFIT_DIFFERENCE + penalty))


def generate_distinguishable() -> Iterator[Hypothesis]:
    """Yield one hypothesis of each class that an image distinguishes."""
    for is_insertion_reversed, mirrored in product((False, True), repeat=2):
        plain = Hypothesis(reversed=(False, False, is_insertion_reversed), mirrored=mirrored)
        for first, second, third in permutations(range(3)):
            yield replace(plain, order=(first, second, third))
        for number in range(5):
            yield replace(plain, number=number)


def generate_equivalents(hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Yield all hypotheses that an image does not distinguish from `hypothesis`, and this one."""
    for first, second, mirrored in product((False, True), repeat=3):
        reversed_ = (first, second, hypothesis.reversed[2])
        candidate = replace(hypothesis, reversed=reversed_, mirrored=mirrored)
        if candidate.is_odd != hypothesis.is_odd:
            continue
        yield candidate
        if hypothesis.number == SPACING:  # an image does not determine the scale of the scene
            yield replace(candidate, number=INSERTION_COUNTS, size=-hypothesis.size)


def fit_all(robot: Robot, views: MarkerViews) -> list[Hypothesis]:
    """Fit one hypothesis of each class; return them by increasing misfit."""
    candidates = generate_distinguishable()
    return sorted((fit_hypothesis(h, robot, views) for h in candidates), key=lambda fit: fit.misfit)


def select_most_likely(fits: list[Hypothesis]) -> list[Hypothesis]:
    """Return the fits about as good as the best one, which is the first.

    If some of them correct no number, return only these: the simpler explanation is more likely.
    """
    close = [fit for fit in fits if fit.is_close(fits[0])]
    return [fit for fit in close if fit.number is None] or close


def fit_hypothesis(candidate: Hypothesis, robot: Robot, views: MarkerViews) -> Hypothesis:
    """Fit the camera and the number that a hypothesis corrects; return the fitted hypothesis."""
    number, has_factor = candidate.number, candidate.corrects_counts
    views = views.mirrored() if candidate.mirrored else views
    joints, descended = candidate.compute_joints(robot.wiring, views.q), views.descended
    views = replace(views, q=joints, descended=descended[:, list(candidate.order)])
    if number is None:
        return replace(candidate, misfit=identify(robot.mechanism, robot.tool, views).misfit)
    initial_size = _guess_factor(robot, views, number) if has_factor else 0.0
    fit = identify(robot.mechanism, robot.tool, views, [number], initial_size)
    size, misfit = float(fit.x[number]), fit.misfit
    deviation = float(np.sqrt(fit.covariance[number, number]))
    if has_factor:
        usual_size = find_usual_factor(size, deviation)
        misfit += 0.0 if usual_size else UNUSUAL_PENALTY
        size = usual_size or size
    return replace(candidate, size=size, deviation=deviation, misfit=misfit)


def _guess_factor(robot: Robot, views: MarkerViews, joint: int) -> float:
    """Return the logarithm of the apparent factor on the motion of a joint, as an initial guess.

    The factor compares the motion in the image with the motion predicted from the rig file, both
    relative to the distance between the markers. The guess is coarse because a motion along the
    line of sight looks short. It is 0 for factors below exp(`MIN_INITIAL_LOG_FACTOR`).
    """
    predicted = compute_corrected_markers(robot.mechanism, robot.tool, views.q, np.zeros(5))
    motion = np.abs(views.q - views.q[0])[:, joint]
    is_far = motion > 0.5 * motion.max()
    expected, observed = (_compute_motion(markers, is_far) for markers in (predicted, views.points))
    size = float(np.log(observed / expected)) if expected > 0.0 and observed > 0.0 else 0.0
    return size if abs(size) > MIN_INITIAL_LOG_FACTOR else 0.0


def _compute_motion(markers: Floats, is_far: NDArray[np.bool_]) -> float:
    """Return the sum of the motions to the chosen poses, relative to the distance of the markers.

    `markers` are (n, 2, k) in mm or px, the motions start at the first pose.
    """
    motions: Floats = markers[is_far] - markers[0]
    vector: Floats = markers[0, 1] - markers[0, 0]
    return float(np.linalg.norm(motions, axis=2).max(axis=1).sum() / np.linalg.norm(vector))


def find_usual_factor(size: float, deviation: float) -> float:
    """Return the logarithm of the usual factor near `size`, a logarithm too; 0 if there is none."""
    tolerance = min(FACTOR_DEVIATIONS * deviation, MAX_FACTOR_TOLERANCE)
    for factor in USUAL_FACTORS:
        if abs(abs(size) - np.log(factor)) < max(FACTOR_TOLERANCE, tolerance):
            return float(np.copysign(np.log(factor), size))
    return 0.0
