"""What may be wrong with a rig file, and where the markers would be then.

A guess says which axis drives which joint, which joints run the other way, whether the picture is
mirrored, and which one number is wrong. From it follow the true joints, given those that the arm
tells, about the place q₀ at which they are taken to be right:

    qⱼ = q₀ⱼ + σⱼ fⱼ (cₖ/cⱼ) (q̃ₖ − q̃₀ₖ),    k the joint whose axis drives joint j

with the counts c of the file, σ = −1 for a joint that runs the other way, and f = 1 but for wrong
counts. First-order motion tells f, zero and spacing, by what a camera can see at all; of the signs
it tells that of the insertion and how many of the others and of mirrors there are, even or odd.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from rcmservo.bringup.view import Fit, Views, fitted
from rcmservo.bringup.wiring import Order, Robot, Wiring
from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import Rcm, position
from rcmservo.method.tool import RIGID, Shaft, second_marker

ORDERS: tuple[Order, ...] = (
    (0, 1, 2),
    (0, 2, 1),
    (1, 0, 2),
    (1, 2, 0),
    (2, 0, 1),
    (2, 1, 0),
)
"""In which the axes may drive the joints."""

RIGHT, COUNTS, ZERO, SPACING = "", "counts", "insertion_zero", "spacing"
"""Which number is wrong."""

FACTOR_WITHIN, ZERO_WITHIN = 2.0, 50.0
"""How far it may be off: the logarithm of a factor, and mm."""

USUAL = 2.0, 4.0, 10.0, 25.4, 180.0 / np.pi, 2.0 * np.pi, 1000.0
"""Factors by which counts are wrong if they are: edges of an encoder, inches, degrees."""
NEAR = 0.04
"""How near to one a factor must come, in its logarithm,"""
DEVIATIONS = 3.0
"""or in standard deviations."""
UNUSUAL = 12.0
"""Squared standard deviations by which another factor is less likely."""

GLANCE = 1.5
"""What a factor's logarithm must be at a glance before a search begins there."""

CLOSE = 25.0
"""Squared standard deviations within which two guesses explain a picture alike."""
EXPLAINED = 4.0
"""Of a number of the picture, on the average: what leaves over more explains nothing."""


@dataclass(frozen=True)
class Guess:
    """What may be wrong."""

    order: Order = (0, 1, 2)
    """The joints of the file whose axes drive joints 1, 2 and 3."""
    reversed: tuple[bool, bool, bool] = (False, False, False)
    """Which joints run the other way."""
    mirrored: bool = False
    """Whether the picture is mirrored."""
    wrong: str = RIGHT
    """RIGHT, or which number is wrong: COUNTS, ZERO or SPACING."""
    joint: int = 0
    """Whose counts are wrong."""
    size: float = 0.0
    """The logarithm of the factor that makes it right, or mm to add to the zero."""
    within: float = field(default=0.0, compare=False)
    """The standard deviation of that size, where it was fitted."""

    @property
    def odd(self) -> bool:
        """Whether mirror and reversed angles are odd in number: that, a picture can tell."""
        return (self.mirrored + self.reversed[0] + self.reversed[1]) % 2 == 1

    def moves(self, joint: int, wiring: Wiring) -> tuple[int, int]:
        """The joint that moves truly where the arm is told to move one up, and which way (±1)."""
        true, c = self.order.index(joint), wiring.counts
        return true, 1 if (c[joint] / c[true] > 0.0) != self.reversed[true] else -1

    def factors(self) -> Floats:
        """By what the counts (3,) of the file would have to be multiplied."""
        factors = np.where(self.reversed, -1.0, 1.0)
        if self.wrong == COUNTS:
            factors[self.joint] /= np.exp(self.size)
        return factors


@dataclass(frozen=True, eq=False)
class Weighed:
    """A guess, fitted to what was seen."""

    guess: Guess
    """With the size that fits best."""
    misfit: float
    """What is left over, squared standard deviations."""

    def close(self, best: "Weighed") -> bool:
        """Whether it explains what was seen about as well as the best one."""
        return self.misfit < best.misfit + CLOSE


def places(guess: Guess, robot: Robot, q: Floats, start: Floats, size: float) -> Floats:
    """Where the markers (n, 2, 3) mm are, the arm telling q (n, 3)."""
    c, order = np.array(robot.wiring.counts), list(guess.order)
    moved = (q - start)[:, order] * c[order] / c * np.where(guess.reversed, -1.0, 1.0)
    if guess.wrong == COUNTS:
        moved[:, guess.joint] *= np.exp(size)
    rcm, shaft = robot.mechanism.rcm(robot.tool.offset), robot.tool.shaft
    if guess.wrong == ZERO:
        rcm = rcm._replace(zero=rcm.zero + size)
    if guess.wrong == SPACING:
        shaft = stretched(shaft, size)
    return markers_at(rcm, start + moved, shaft)


@compiled
def markers_at(rcm: Rcm, q: Floats, shaft: Shaft) -> Floats:
    """Return p₁ and p₂ (n, 2, 3) mm at the joints q (n, 3), eq. (2)."""
    markers = np.empty((len(q), 2, 3))
    for i in range(len(q)):
        markers[i, 0] = position(rcm, q[i])
        markers[i, 1] = second_marker(shaft, markers[i, 0])
    return markers


def stretched(shaft: Shaft, size: float) -> Shaft:
    """The tool with its markers further apart by the factor exp(size)."""
    if shaft.kind == RIGID:
        return Shaft(shaft.kind, shaft.value * float(np.exp(size)))
    return Shaft(shaft.kind, 1.0 + (shaft.value - 1.0) * float(np.exp(size)))


def kinds() -> Iterator[Guess]:
    """One guess of each kind that a picture can tell apart."""
    signs = [(False, False, back) for back in (False, True)]
    for back, mirrored in product(signs, (False, True)):
        for order in ORDERS:
            yield Guess(order=order, reversed=back, mirrored=mirrored)
        for joint in range(3):
            yield Guess(reversed=back, mirrored=mirrored, wrong=COUNTS, joint=joint)
        for wrong in (ZERO, SPACING):
            yield Guess(reversed=back, mirrored=mirrored, wrong=wrong)


def judged(guess: Guess, robot: Robot, seen: Views) -> Weighed:
    """How well a guess explains what was seen, the first place being the start."""
    start = seen.q[0]
    within = {RIGHT: [], ZERO: [ZERO_WITHIN]}.get(guess.wrong, [FACTOR_WITHIN])
    begin = [_at_a_glance(guess, robot, seen)] if guess.wrong == COUNTS else [0.0] * len(within)

    def at(free: Floats) -> Floats:
        return places(guess, robot, seen.q, start, float(free[0]) if len(free) else 0.0)

    fit = fitted(seen.mirrored() if guess.mirrored else seen, at, np.array(within), np.array(begin))
    return _sized(guess, fit)


def _travel_over_distance(at: Floats, far: NDArray[np.bool_]) -> float:
    """The travel of the markers (n, 2, ...), over their first distance from each other."""
    first: Floats = at[0]
    between: Floats = first[1] - first[0]
    return np.linalg.norm(at - first, axis=2).max(axis=1)[far].sum() / np.linalg.norm(between)


def _at_a_glance(guess: Guess, robot: Robot, seen: Views) -> float:
    """The logarithm of the factor by which a joint's motion looks larger than the file says, seen
    against the distance between the markers; 0 where that is about 1. It may lie across the line of
    sight or along it, so this is only where a search begins."""
    usual = places(guess, robot, seen.q, seen.q[0], 0.0)
    moved = np.abs(seen.q - seen.q[0])[:, guess.joint]
    far = moved > 0.5 * moved.max()
    said, shown = (_travel_over_distance(at, far) for at in (usual, seen.points))
    size = float(np.log(shown / said)) if said > 0.0 and shown > 0.0 else 0.0
    return size if abs(size) > GLANCE else 0.0


def _sized(guess: Guess, fit: Fit) -> Weighed:
    if guess.wrong == RIGHT:
        return Weighed(guess, fit.misfit)
    size, within = float(fit.free[0]), float(fit.within[0])
    misfit = fit.misfit
    if guess.wrong == COUNTS:
        usual = usual_factor(size, within)
        misfit += 0.0 if usual else UNUSUAL
        size = usual or size
    return Weighed(replace(guess, size=size, within=within), misfit)


def usual_factor(size: float, within: float) -> float:
    """The logarithm of the usual factor that one (its logarithm given) is near to, 0 if none."""
    for factor in USUAL:
        if abs(abs(size) - np.log(factor)) < max(NEAR, min(DEVIATIONS * within, 0.3)):
            return float(np.copysign(np.log(factor), size))
    return 0.0


def judge_all(robot: Robot, seen: Views) -> list[Weighed]:
    """All kinds of guesses, the best first."""
    return sorted((judged(kind, robot, seen) for kind in kinds()), key=lambda one: one.misfit)


def believed(all_: list[Weighed]) -> list[Weighed]:
    """Those that explain what was seen about as well as the best one, which is the first.

    One that needs no wrong number is believed before all that need one.
    """
    close = [one for one in all_ if one.close(all_[0])]
    plain = [one for one in close if one.guess.wrong == RIGHT]
    return plain or close


def passing(one: Weighed) -> float:
    """By how much a number may be wrong, as its size is told, before a guess without a wrong one is
    believed no more."""
    unusual = UNUSUAL if one.guess.wrong == COUNTS else 0.0
    return one.guess.within * float(np.sqrt(CLOSE + unusual))


def explains(one: Weighed, seen: Views) -> bool:
    """Whether a guess leaves over no more than noise and a lens may."""
    return one.misfit < EXPLAINED * seen.points.size


def members(kind: Weighed) -> Iterator[Guess]:
    """All guesses of which a picture cannot tell this one apart."""
    guess = kind.guess
    for one, other, mirrored in product((False, True), repeat=3):
        back = (one, other, guess.reversed[2])
        member = replace(guess, reversed=back, mirrored=mirrored)
        if member.odd != guess.odd:
            continue
        yield member
        if guess.wrong == SPACING:  # the whole world larger looks the same
            yield replace(member, wrong=COUNTS, joint=2, size=-guess.size)
