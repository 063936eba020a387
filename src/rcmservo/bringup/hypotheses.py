"""Hypotheses about the mistake in a rig file, each fitted to the observations.

A hypothesis assigns axes to joints, reverses joints, mirrors the picture and frees one number of
the arm. The joints qⱼ follow from the reported ones q̃ and the counts c of the file, with k the
joint whose axis drives joint j and σ = −1 for a reversed joint:

    qⱼ = q₀ⱼ + σⱼ fⱼ (cₖ/cⱼ) (q̃ₖ − q̃₀ₖ)

First-order motion determines f, zero and spacing as far as a camera can. Of the signs it determines
that of the insertion, and whether the number of reversed angles and mirrors is even or odd.
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
"""Usual mistakes in counts: edges of an encoder, inches, degrees, metres."""
FACTOR_TOLERANCE = 0.04
"""Distance from a usual factor in its logarithm within which it is taken,"""
FACTOR_DEVIATIONS, MAX_FACTOR_TOLERANCE = 3.0, 0.3
"""or in standard deviations, up to another one in the logarithm."""
UNUSUAL_PENALTY = 12.0
"""Misfit (squared standard deviations) added for any other factor."""
MIN_FIRST_FACTOR = 1.5
"""Logarithm of an apparent factor from which on the search begins there."""

INDISTINGUISHABLE = 25.0
"""Difference of misfit (squared standard deviations) within which two hypotheses explain a picture
alike."""
MAX_MEAN_SQUARE = 4.0
"""Mean square of the residuals beyond which a hypothesis explains nothing."""


@dataclass(frozen=True)
class Hypothesis:
    """A possible mistake in the rig file, or none.

    Parameters
    ----------
    order : Order
        The joints of the file whose axes drive joints 1, 2 and 3.
    reversed : tuple[bool, bool, bool]
        Joints that run in the other direction.
    mirrored : bool
        True if the picture is mirrored.
    number : int or None
        Index of the number of the arm to correct: counts of joint 1, 2, 3, `ZERO` or `SPACING`.
    size : float
        Its correction: the logarithm of a factor, or mm of the zero.
    deviation : float
        Standard deviation of that size, where it was fitted.
    misfit : float
        Sum of the squared residuals in standard deviations, where it was fitted.
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
        """True if its number is the counts of a joint."""
        return self.number is not None and self.number < ZERO

    @property
    def is_odd(self) -> bool:
        """True if mirror and reversed angles are odd in number, which a picture determines."""
        return (self.mirrored + self.reversed[0] + self.reversed[1]) % 2 == 1

    @property
    def counts_factors(self) -> Floats:
        """Factors (3,) that correct the counts of the file."""
        signs = np.where(self.reversed, -1.0, 1.0)
        return signs * np.exp(-self.correction[:ZERO])

    @property
    def correction(self) -> Floats:
        """Corrections (5,) of the arm."""
        return np.where(np.arange(5) == self.number, self.size, 0.0)

    def moves(self, joint: int, wiring: Wiring) -> tuple[int, int]:
        """Return the joint that truly moves, and its direction (±1), when one is commanded up."""
        true, c = self.order.index(joint), wiring.counts
        return true, 1 if (c[joint] / c[true] > 0.0) != self.reversed[true] else -1

    def joints(self, wiring: Wiring, q: Floats) -> Floats:
        """Return the joints (n, 3) but for the correction, from the reported ones q (n, 3)."""
        c, order = np.array(wiring.counts), list(self.order)
        signs = np.where(self.reversed, -1.0, 1.0)
        return q[0] + (q - q[0])[:, order] * c[order] / c * signs

    def markers(self, robot: Robot, q: Floats) -> Floats:
        """Return the markers (n, 2, 3) mm where the arm reports q (n, 3)."""
        joints = self.joints(robot.wiring, q)
        return corrected_markers(robot.mechanism, robot.tool, joints, self.correction)

    def travel(self, robot: Robot, q: Floats, joint: int, motion: float) -> float:
        """Return the mm that marker 2 moves from q (3,) when a joint moves by rad or mm."""
        both = np.stack([q, q])
        both[1, joint] += motion
        first, second = self.markers(robot, both)[:, 1]
        return float(np.linalg.norm(second - first))

    def explains(self, views: MarkerViews) -> bool:
        """Return whether the residuals are no more than noise and lens distortion may make."""
        return self.misfit < MAX_MEAN_SQUARE * views.points.size

    def is_close(self, best: "Hypothesis") -> bool:
        """Return whether it explains the observations about as well as the best one."""
        return self.misfit < best.misfit + INDISTINGUISHABLE

    @property
    def undetectable(self) -> float:
        """The correction that its number may need without being detected."""
        unusual = UNUSUAL_PENALTY if self.corrects_counts else 0.0
        return self.deviation * float(np.sqrt(INDISTINGUISHABLE + unusual))


def distinguishable() -> Iterator[Hypothesis]:
    """Yield one hypothesis of each kind that a picture distinguishes."""
    for insertion, mirrored in product((False, True), repeat=2):
        plain = Hypothesis(reversed=(False, False, insertion), mirrored=mirrored)
        for one, two, three in permutations(range(3)):
            yield replace(plain, order=(one, two, three))
        for number in range(5):
            yield replace(plain, number=number)


def equivalents(hypothesis: Hypothesis) -> Iterator[Hypothesis]:
    """Yield all hypotheses that a picture does not distinguish from one."""
    for one, two, mirrored in product((False, True), repeat=3):
        reversed_ = (one, two, hypothesis.reversed[2])
        other = replace(hypothesis, reversed=reversed_, mirrored=mirrored)
        if other.is_odd != hypothesis.is_odd:
            continue
        yield other
        if hypothesis.number == SPACING:  # a larger world looks the same
            yield replace(other, number=INSERTION_COUNTS, size=-hypothesis.size)


def fit_all(robot: Robot, views: MarkerViews) -> list[Hypothesis]:
    """Fit one hypothesis of each kind; the best comes first."""
    fits = (fitted(one, robot, views) for one in distinguishable())
    return sorted(fits, key=lambda fit: fit.misfit)


def most_likely(fits: list[Hypothesis]) -> list[Hypothesis]:
    """Return the fits close to the best one: those without a correction if there are any."""
    close = [fit for fit in fits if fit.is_close(fits[0])]
    return [fit for fit in close if fit.number is None] or close


def fitted(one: Hypothesis, robot: Robot, views: MarkerViews) -> Hypothesis:
    """Identify the camera and the number that a hypothesis frees."""
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
    """Return the logarithm of the factor by which the motion of a joint looks larger than the file
    says, relative to the distance between the markers; 0 if it is about 1.

    The motion may lie across the line of sight or along it: this is where a search begins, no more.
    """
    markers = corrected_markers(robot.mechanism, robot.tool, views.q, np.zeros(5))
    moved = np.abs(views.q - views.q[0])[:, joint]
    far = moved > 0.5 * moved.max()
    expected, shown = (
        np.linalg.norm(at[far] - at[0], axis=2).max(axis=1).sum()
        / np.linalg.norm(at[0, 1] - at[0, 0])
        for at in (markers, views.points)
    )
    size = float(np.log(shown / expected)) if expected > 0.0 and shown > 0.0 else 0.0
    return size if abs(size) > MIN_FIRST_FACTOR else 0.0


def usual_factor(size: float, deviation: float) -> float:
    """Return the logarithm of the usual factor near one (its logarithm given), 0 if none is."""
    tolerance = min(FACTOR_DEVIATIONS * deviation, MAX_FACTOR_TOLERANCE)
    for factor in USUAL_FACTORS:
        if abs(abs(size) - np.log(factor)) < max(FACTOR_TOLERANCE, tolerance):
            return float(np.copysign(np.log(factor), size))
    return 0.0
