"""What can be wrong at a tick, told from what the servo sees: pure checks, each one a line of the
table of faults.

Every check is written so that NaN trips it. What must be compared over time (frames with the motion
between them, joints with the commands before) is kept in a `Watch`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.errors import require
from rcmservo.guard.states import Cause
from rcmservo.interfaces import Command, Dropped, Floats, Observation
from rcmservo.method.features import SCALE, about, difference, features

NO_PIXEL = 1e6
"""px from where on a coordinate is no marker's."""

REJECTED_IN_A_ROW = 3
REJECTED_FOR_GOOD = 30
"""Frames in a row after which what seemed mistaken must be the view itself."""

LATE_IN_A_ROW = 3
DISAGREEMENTS = 5

FIRST_PERIOD = 100_000_000
"""ns between frames that are expected while only one has been seen."""

LATE_SHARE = 0.5
"""Share of its period by which a tick may come late."""

NEAREST = 20.0
"""px by which 1 mm of motion may move a marker in the picture, where no estimate tells it
better."""

FASTEST = 30.0
"""Largest entry of the scaled Ĵ, 1/mm: 30 mm⁻¹ is 300 px a mm."""

TELLING = 0.2
"""Scaled feature change, as predicted, from which on a motion tells whether the estimate is
right."""

WRONG = 0.75
"""Share of the predicted change by which the measured one may differ, beside TELLING itself."""

DRIVE_LAG = 0.025
"""s by which a joint is taken to follow its commanded rate."""

FORGET = 1.0
"""s over which the following error forgets: a slow drift is no fault of the drive."""

SLACK = 0.005
"""Share of a joint's range by which it may stand beyond its limit."""

STILL = np.zeros(3)

MARKER_CAUSES = {
    (True, False): Cause.MARKER_1_LOST,
    (False, True): Cause.MARKER_2_LOST,
    (True, True): Cause.MARKERS_LOST,
}
DROPPED_CAUSES = {
    Dropped.NONE: Cause.STALE,
    Dropped.NOT_NEW: Cause.FRAMES_NOT_NEW,
    Dropped.CLOCK: Cause.FRAMES_CLOCK,
    Dropped.DAMAGED: Cause.FRAMES_DAMAGED,
}


@dataclass(frozen=True)
class Thresholds:
    """From where on something is a fault."""

    stale_slow: float = 1.5
    """Age of the newest frame since it arrived, in frame periods, from which on the tool goes
    slowly."""
    stale_hold: float = 3.0
    """The same for standing still."""
    latency: float = 0.1
    """Longest time from a frame's exposure to the command made of it, s; up to it latency is
    compensated."""
    silence: float = 0.05
    """Longest time for which the arm may not answer, s."""
    overrun: float = 0.05
    """Longest time by which one tick may come late, s."""
    following: tuple[float, float, float] = (0.008, 0.008, 0.6)
    """How far each joint may stand from where its commands should have brought it (rad, rad,
    mm)."""
    jump: float = 3.0
    """How far a marker may be from where the tool's motion puts it, px, beside the predicted motion
    itself."""

    def __post_init__(self) -> None:
        require(
            self.stale_slow >= 1.0,
            "thresholds.stale_slow",
            self.stale_slow,
            "at least 1 frame period",
        )
        above = self.stale_slow <= self.stale_hold < math.inf
        require(
            above,
            "thresholds.stale_hold",
            self.stale_hold,
            "a number of frame periods not below stale_slow",
        )
        for name in ("latency", "silence", "overrun"):
            value = getattr(self, name)
            require(
                0.0 < value <= 1.0, f"thresholds.{name}", value, "a time above 0 and at most 1 s"
            )
        good = len(self.following) == 3 and all(0.0 < value < math.inf for value in self.following)
        require(
            good, "thresholds.following", self.following, "three positive numbers (rad, rad, mm)"
        )
        require(0.0 < self.jump < math.inf, "thresholds.jump", self.jump, "a positive number of px")


class Watch(NamedTuple):
    """What the checks remember.

    Of the arm: ``reached`` (3,), where its commands should have brought the joints when it ``told``
    (ns) them last, and their lagging ``rates`` (3,).
    Of the loop: ``late``, ticks that came late in a row, and the ``gap`` ns between the last two.
    Of the camera: the newest ``frame``, its ``exposure`` ns, its ``latency`` ns from there to its
    tick, and the ``period`` ns between frames (0: unknown).
    Of the markers: ``rejected`` frames in a row, of which ``jumped`` saw both markers jump and
    ``swapped`` each near the other's place.
    Of the estimate: ``p1`` (3,) and ``points`` (2, 2) from which on it is judged next, and
    ``wrong``, how often in a row it was.
    """

    reached: Floats
    rates: Floats
    told: int
    late: int
    gap: int
    frame: int
    exposure: int
    period: float
    latency: int
    rejected: int
    jumped: int
    swapped: int
    elsewhere: Floats
    p1: Floats
    points: Floats
    wrong: int


def begin() -> Watch:
    """Nothing seen yet."""
    unknown = np.full(3, np.nan)
    nowhere = np.full((2, 2), np.nan)
    return Watch(
        unknown, np.zeros(3), 0, 0, 0, -1, 0, 0.0, 0, 0, 0, 0, nowhere, unknown, nowhere, 0
    )


def unwatched(watch: Watch, markers: bool) -> Watch:
    """The watch of the same arm and camera with its counts begun anew, those of rejected `markers`
    too if asked for."""
    watch = watch._replace(late=0, p1=np.full(3, np.nan), wrong=0)
    return watch._replace(rejected=0, jumped=0, swapped=0) if markers else watch


def finite(numbers: Floats) -> bool:
    """Whether all are finite; NumPy's own way takes ten times as long on three numbers."""
    return all(map(math.isfinite, numbers.tolist()))


def lost(points: Floats) -> tuple[bool, bool]:
    """Whether marker 1 and marker 2 are lost: raw pixels (2, 2) not finite, or such as no camera
    has."""
    (u1, v1), (u2, v2) = points.tolist()
    return not (abs(u1) < NO_PIXEL and abs(v1) < NO_PIXEL), not (
        abs(u2) < NO_PIXEL and abs(v2) < NO_PIXEL
    )


@compiled
def followed(
    reached: Floats, rates: Floats, applied: Floats, q: Floats, dt: float
) -> tuple[Floats, Floats]:
    """Where the joints should be dt s later, and their lagging rates, by the rates that the arm
    took."""
    left = np.exp(-dt / DRIVE_LAG)
    reached = reached + applied * dt + (rates - applied) * DRIVE_LAG * (1.0 - left)
    return reached + (q - reached) * min(dt / FORGET, 1.0), applied + (rates - applied) * left


@compiled
def placed(y: Floats, toward: float) -> Floats:
    """The markers (4,) px from o_c of the features y, on a line through it; `toward` is −1 if m₁
    lies beyond o_c."""
    c, s = np.cos(y[0]), np.sin(y[0])
    r, end = toward * y[1], toward * y[1] + y[2]
    return np.array([r * c, r * s, end * c, end * s])


@compiled
def misplaced(
    points: Floats,
    before: Floats,
    o_c: Floats,
    y: Floats,
    J_hat: Floats,
    delta_p: Floats,
    jump: float,
) -> tuple[bool, bool, bool]:
    """Whether marker 1, marker 2 are not where the motion Δp₁ puts them, and whether each is where
    the other should be.

    The markers' predicted motion follows from y + Ĵ Δp₁, as the imaged tool passes through o_c.
    """
    toward = (
        1.0
        if (before[0, 0] - o_c[0]) * np.cos(y[0]) + (before[0, 1] - o_c[1]) * np.sin(y[0]) >= 0.0
        else -1.0
    )
    way = (placed(y + J_hat @ delta_p, toward) - placed(y, toward)).reshape(2, 2)
    there = before + way
    off = np.empty(2)
    crossed = np.empty(2)
    for i in range(2):
        allowed = jump + np.sqrt(way[i, 0] ** 2 + way[i, 1] ** 2)
        off[i] = (
            np.sqrt((points[i, 0] - there[i, 0]) ** 2 + (points[i, 1] - there[i, 1]) ** 2) - allowed
        )
        crossed[i] = (
            np.sqrt((points[i, 0] - there[1 - i, 0]) ** 2 + (points[i, 1] - there[1 - i, 1]) ** 2)
            - allowed
        )
    return not off[0] <= 0.0, not off[1] <= 0.0, crossed[0] <= 0.0 and crossed[1] <= 0.0


@compiled
def leapt(points: Floats, before: Floats, delta_p: Floats, jump: float) -> tuple[bool, bool, bool]:
    """The same without an estimate: whether they moved further than any camera sees a tool move by
    Δp₁ mm."""
    allowed = jump + NEAREST * np.sqrt(np.sum(delta_p**2))
    off = np.empty(2)
    crossed = np.empty(2)
    for i in range(2):
        off[i] = np.sqrt(np.sum((points[i] - before[i]) ** 2))
        crossed[i] = np.sqrt(np.sum((points[i] - before[1 - i]) ** 2))
    return (
        not off[0] <= allowed,
        not off[1] <= allowed,
        crossed[0] <= allowed and crossed[1] <= allowed,
    )


@compiled
def judged(points: Floats, before: Floats, o_c: Floats, J_hat: Floats, delta_p: Floats) -> int:
    """Whether the markers' change bears the estimate out (0) or not (1); −1 while the motion is too
    small to tell."""
    predicted = (J_hat @ delta_p) / SCALE
    size = np.max(np.abs(predicted))
    if size < TELLING:
        return -1
    change = difference(features(about(points, o_c)), features(about(before, o_c)))
    return 0 if np.max(np.abs(change / SCALE - predicted)) <= TELLING + WRONG * size else 1


def watch_loop(watch: Watch, last: Command, seen: Observation, period: int) -> Watch:
    """The watch after one more tick: how late it came, and where the joints should be."""
    gap = seen.now - last.time if last.number > 0 else period
    late = watch.late + 1 if gap > (1.0 + LATE_SHARE) * period else 0
    reached, rates = seen.q, np.zeros(3)
    if seen.enabled and finite(watch.reached):
        dt = max(seen.q_time - watch.told, 0) * 1e-9
        reached, rates = followed(watch.reached, watch.rates, seen.applied, seen.q, dt)
    return watch._replace(reached=reached, rates=rates, told=seen.q_time, late=late, gap=gap)


def watch_frame(watch: Watch, seen: Observation, limits: Thresholds) -> Watch:
    """The watch after a new frame: its latency, and the period between frames, which no gap may
    stretch at once."""
    period, count = watch.period, seen.frame - watch.frame
    if watch.frame >= 0:
        one = (seen.exposure - watch.exposure) / count
        one = min(one, limits.stale_slow * period if period else FIRST_PERIOD)
        period = period + 0.2 * (one - period) if period else one
    return watch._replace(
        frame=seen.frame, exposure=seen.exposure, period=period, latency=seen.now - seen.exposure
    )


def stays(watch: Watch, points: Floats, jump: float) -> bool:
    """Whether the markers are still where the frame before was rejected for showing them."""
    return watch.rejected > 0 and not any(leapt(points, watch.elsewhere, STILL, 2.0 * jump)[:2])


def watch_markers(
    watch: Watch, first: bool, second: bool, crossed: bool, points: Floats, jump: float
) -> Watch:
    """The watch after one more frame in which the first, the second marker is out of place, or each
    in the other's.

    Both have jumped for good only if their new places agree from frame to frame: nonsense does not.
    """
    if not (first or second):
        return watch._replace(rejected=0, jumped=0, swapped=0)
    both = first and second
    steady = watch.rejected == 0 or stays(watch, points, jump)
    return watch._replace(
        rejected=watch.rejected + 1,
        jumped=watch.jumped + 1 if both and steady else int(both),
        swapped=watch.swapped + 1 if both and crossed else 0,
        elsewhere=points,
    )


def watch_estimate(watch: Watch, p1: Floats, points: Floats, o_c: Floats, J_hat: Floats) -> Watch:
    """The watch after the estimate was judged by what the motion since it was judged last has
    changed."""
    if not finite(watch.p1):
        return watch._replace(p1=p1, points=points)
    verdict = judged(points, watch.points, o_c, J_hat, p1 - watch.p1)
    if verdict < 0:
        return watch
    return watch._replace(p1=p1, points=points, wrong=watch.wrong + 1 if verdict else 0)


def arm_faults(
    watch: Watch, seen: Observation, on: bool, lower: Floats, upper: Floats, limits: Thresholds
) -> Iterator[Cause]:
    """What is wrong with the arm; `on`, whether its drive should be."""
    if not finite(seen.q):
        yield Cause.JOINTS_NOT_FINITE
        return
    if on and not seen.enabled:
        yield Cause.DRIVE_OFF
    if not abs(seen.now - seen.q_time) <= limits.silence * 1e9:
        yield Cause.ARM_SILENT
    for q, reached, low, high, bound in zip(
        seen.q.tolist(),
        watch.reached.tolist(),
        lower.tolist(),
        upper.tolist(),
        limits.following,
        strict=True,
    ):
        slack = SLACK * (high - low)
        if not low - slack <= q <= high + slack:
            yield Cause.BEYOND_LIMIT
        if not abs(q - reached) <= bound:
            yield Cause.NOT_FOLLOWING


def loop_faults(
    watch: Watch, seen: Observation, period: int, limits: Thresholds
) -> Iterator[Cause]:
    """What is wrong with the loop and its record."""
    if watch.late >= LATE_IN_A_ROW or not watch.gap - period <= limits.overrun * 1e9:
        yield Cause.OVERRUN
    elif watch.late:
        yield Cause.LATE_TICK
    if not seen.recorded:
        yield Cause.NOT_RECORDED


def camera_faults(watch: Watch, seen: Observation, limits: Thresholds) -> Iterator[Cause]:
    """What is wrong with the frames and with where they show the markers."""
    if seen.frame < watch.frame:
        yield Cause.FRAMES_NOT_NEW
    if seen.frame < 0:
        return
    gone = lost(seen.points)
    if any(gone):
        yield MARKER_CAUSES[gone]
    if not finite(seen.q_exposure):
        yield Cause.JOINTS_UNKNOWN
    if not watch.latency <= limits.latency * 1e9:
        yield Cause.LATE
    age = (seen.now - seen.arrival) / (watch.period or FIRST_PERIOD)
    if not age <= limits.stale_hold:
        yield DROPPED_CAUSES[seen.dropped]
    elif not age <= limits.stale_slow:
        yield Cause.AGEING
    if watch.rejected >= REJECTED_IN_A_ROW:
        yield _rejected(watch)
    elif watch.rejected:
        yield Cause.REJECTED


def _rejected(watch: Watch) -> Cause:
    if watch.swapped >= REJECTED_IN_A_ROW:
        return Cause.SWAPPED
    moved = watch.jumped >= REJECTED_IN_A_ROW or watch.rejected >= REJECTED_FOR_GOOD
    return Cause.CAMERA_MOVED if moved else Cause.SURPRISED
