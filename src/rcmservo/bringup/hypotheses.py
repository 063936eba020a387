"""Hypotheses about one error in a rig file, each fitted to the observations.

A hypothesis assigns axes to joints, reverses joints, mirrors the image and corrects at most one
number of the arm. With k the index of the axis that drives joint j and σ = −1 for a reversed
joint, the joints qⱼ follow from the reported ones q̃ and the counts c of the file:

    qⱼ = q₀ⱼ + σⱼ fⱼ (cₖ/cⱼ) (q̃ₖ − q̃₀ₖ)

Small motions identify the factors f, the zero of the insertion and the spacing of the markers as
far as a camera allows. They identify the sign of the insertion. Of the two angles and the mirror
they identify only the parity: an even or an odd number of reversals.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import permutations, product

import numpy as np

from rcmservo.bringup.axis_wiring import Order, Robot, Wiring
from rcmservo.bringup.identification import (
    SPACING,
    ZERO,
    MarkerViews,
    corrected_markers,
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
MIN_FIRST_FACTOR = 1.5
"""Logarithm of an apparent factor beyond which the search starts at that factor, not at 1."""

INDISTINGUISHABLE = 25.0
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

    def moves(self, joint: int, wiring: Wiring) -> tuple[int, int]:
        """Return the joint that moves, and its sign (±1), if `joint` is commanded upwards."""
        true, c = self.order.index(joint), wiring.counts
        return true, 1 if (c[joint] / c[true] > 0.0) != self.reversed[true] else -1

    def joints(self, wiring: Wiring, q: Floats) -> Floats:
        """Return the joints (n, 3) from the reported `q` (n, 3), before any correction of a number.

        The module's equation with f = 1.
        """
        c, order = np.array(wiring.counts), list(self.order)
        signs = np.where(self.reversed, -1.0, 1.0)
        return q[0] + (q - q[0])[:, order] * c[order] / c * signs

    def markers(self, robot: Robot, q: Floats) -> Floats:
        """Return the markers (n, 2, 3) in mm for the reported joints `q` (n, 3)."""
        joints = self.joints(robot.wiring, q)
        return corrected_markers(robot.mechanism, robot.tool, joints, self.correction)

    def travel(self, robot: Robot, q: Floats, joint: int, motion: float) -> float:
        """Return the travel of marker 2 in mm for a `motion` (rad or mm) of a joint from q (3,)."""
        both = np.stack([q, q])
        both[1, joint] += motion
        first, second = self.markers(robot, both)[:, 1]
        return float(np.linalg.norm(second - first))

    def explains(self, views: MarkerViews) -> bool:
        """Return whether noise and lens distortion can cause the residuals."""
        return self.misfit < MAX_MEAN_SQUARE * views.points.size

    def is_close(self, best: "Hypothesis") -> bool:
        """Return whether the misfit is within `INDISTINGUISHABLE` of that of the best fit."""
        return self.misfit < best.misfit + INDISTINGUISHABLE

    @property
    def undetectable(self) -> float:
        """Largest error of its number that would remain undetected, in the unit of `size`."""
        unusual = UNUSUAL_PENALTY if self.corrects_counts else 0.0
        return self.deviation * float(np.sqrt(INDISTINGUISHABLE + unusual))


def distinguishable_hypotheses() -> Iterator[Hypothesis]:
    """Yield one hypothesis of each class that an image distinguishes."""
    for insertion, mirrored in product((False, True), repeat=2):
        plain = Hypothesis(reversed=(False, False, insertion), mirrored=mirrored)
        for one, two, three in permutations(range(3)):
            yield replace(plain, order=(one, two, three))
        for number in range(5):
            yield replace(plain, number=number)


def equivalents(hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Yield all hypotheses that an image does not distinguish from one, and that one itself."""
    for one, two, mirrored in product((False, True), repeat=3):
        reversed_ = (one, two, hypothesis.reversed[2])
        other = replace(hypothesis, reversed=reversed_, mirrored=mirrored)
        if other.is_odd != hypothesis.is_odd:
            continue
        yield other
        if hypothesis.number == SPACING:  # an image does not determine the scale of the scene
            yield replace(other, number=INSERTION_COUNTS, size=-hypothesis.size)


def fit_all(robot: Robot, views: MarkerViews) -> list[Hypothesis]:
    """Fit one hypothesis of each class; return them by increasing misfit."""
    fits = (fit_hypothesis(one, robot, views) for one in distinguishable_hypotheses())
    return sorted(fits, key=lambda fit: fit.misfit)


def most_likely(fits: list[Hypothesis]) -> list[Hypothesis]:
    """Return the fits about as good as the best one, of these only those without a correction.

    If all of them correct a number, return all of them.
    """
    close = [fit for fit in fits if fit.is_close(fits[0])]
    return [fit for fit in close if fit.number is None] or close


def fit_hypothesis(one: Hypothesis, robot: Robot, views: MarkerViews) -> Hypothesis:
    """Fit the camera, and the number that a hypothesis corrects; return the fitted hypothesis."""
    views = views.mirrored() if one.mirrored else views
    views = replace(views, q=one.joints(robot.wiring, views.q))
    if one.number is None:
        return replace(one, misfit=identify(robot.mechanism, robot.tool, views).misfit)
    begin = _apparent_factor(robot, views, one.number) if one.corrects_counts else 0.0
    fit = identify(robot.mechanism, robot.tool, views, [one.number], begin)
    size, misfit = float(fit.x[one.number]), fit.misfit
    deviation = float(np.sqrt(fit.covariance[one.number, one.number]))
    if one.corrects_counts:
        usual = usual_factor(size, deviation)
        misfit += 0.0 if usual else UNUSUAL_PENALTY
        size = usual or size
    return replace(one, size=size, deviation=deviation, misfit=misfit)


def _apparent_factor(robot: Robot, views: MarkerViews, joint: int) -> float:
    """Return the logarithm of the apparent factor on the motion of a joint, as an initial guess.

    The factor compares the motion in the image with the motion predicted from the rig file, both
    relative to the distance between the markers. Factors below exp(`MIN_FIRST_FACTOR`) give 0. The
    guess is coarse because a motion along the line of sight looks short.
    """
    markers = corrected_markers(robot.mechanism, robot.tool, views.q, np.zeros(5))
    moved = np.abs(views.q - views.q[0])[:, joint]
    far = moved > 0.5 * moved.max()
    expected, observed = (
        np.linalg.norm(at[far] - at[0], axis=2).max(axis=1).sum()
        / np.linalg.norm(at[0, 1] - at[0, 0])
        for at in (markers, views.points)
    )
    size = float(np.log(observed / expected)) if expected > 0.0 and observed > 0.0 else 0.0
    return size if abs(size) > MIN_FIRST_FACTOR else 0.0


def usual_factor(size: float, deviation: float) -> float:
    """Return the logarithm of the usual factor near `size`, a logarithm too; 0 if there is none."""
    tolerance = min(FACTOR_DEVIATIONS * deviation, MAX_FACTOR_TOLERANCE)
    for factor in USUAL_FACTORS:
        if abs(abs(size) - np.log(factor)) < max(FACTOR_TOLERANCE, tolerance):
            return float(np.copysign(np.log(factor), size))
    return 0.0
