"""One closed loop as one compiled function: the twin of the laboratory and the live servo's own
step."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled
from rcmservo.guard.watch import Told
from rcmservo.interfaces import Floats
from rcmservo.loops import fill, length, minus, put
from rcmservo.method.estimators.compiled_ones import AnyRule, Memory
from rcmservo.method.kinematics import position
from rcmservo.method.tool import second_marker
from rcmservo.servo.act import Kept
from rcmservo.servo.dials import Asked, Fixed, rcm_of
from rcmservo.servo.one_kernel import tick
from rcmservo.study.twin import (
    PAST,
    Twin,
    advance,
    between,
    counted,
    joints_at,
    newest,
    place,
    project,
    take,
)


class Start(NamedTuple):
    """What a closed loop begins with."""

    kept: Kept
    """What the servo remembers."""
    memory: Memory
    """What its estimator does."""
    fixed: Fixed
    """What the servo is made of."""
    rule: AnyRule
    """What its estimator is."""
    now: int
    """When the first tick is, ns."""


class Goal(NamedTuple):
    """What a closed loop goes to."""

    points: Floats
    """The target's markers (2, 2) raw px."""
    p2: Floats
    """Where marker 2 truly was, (3,) mm."""


class Course(NamedTuple):
    """What a closed loop leaves, of every tick."""

    error: Floats
    """(n,) mm from marker 2 to where it was shown."""
    phase: NDArray[np.int8]
    """(n,) places in Phase."""
    cause: NDArray[np.int8]
    """(n,) places in Cause."""


class Newest(NamedTuple):
    """The newest frame."""

    number: int
    """-1 before the first."""
    exposure: int
    """ns."""
    arrival: int
    """ns."""
    q: Floats
    """The joints (3,) at the exposure, as the arm told them."""
    points: Floats
    """The markers (2, 2) px."""


@compiled
def closed_loop(start: Start, twin: Twin, shown: Goal, noise: Floats, trace: Course) -> None:
    """Servo for as many ticks as the trace is long.

    `noise` (frames, 2, 2) px is added to what the camera sees in each frame from the first tick on.
    """
    kept, memory, fixed = start.kept, start.memory, start.fixed
    c, a = fixed.dials[0], twin.drives[0]
    place(twin, start.now)
    skipped = newest(twin.lens[0], start.now)
    frame = Newest(-1, 0, 0, np.full(3, np.nan), np.full((2, 2), np.nan))
    for k in range(len(trace.error)):
        now = start.now + k * c.period
        advance(twin, now)
        q = counted(twin)
        put(twin.told[k % PAST], q)
        number = newest(twin.lens[0], now)
        if number > max(frame.number, skipped):
            frame = taken(twin, number, noise[number - skipped - 1], start, k, fixed)
        last = kept.decision[0]
        gap = now - last.time if last.number > 0 else c.period
        seen = Told(
            now, gap, q, now, a.on, a.applied.copy(), frame.number, frame.exposure, frame.arrival,
            frame.q, frame.points, 0, True,
        )  # fmt: skip
        asked = Asked(shown.points, start.now, k == 0, 0)
        kept, memory = tick(kept, memory, seen, asked, fixed, start.rule)
        d = kept.decision[0]
        take(twin, d.sent, d.on)
        p2 = second_marker(fixed.shaft, position(rcm_of(c), a.q))
        trace.error[k] = length(minus(p2, shown.p2))
        trace.phase[k], trace.cause[k] = d.phase, d.cause


@compiled
def taken(twin: Twin, number: int, noise: Floats, start: Start, k: int, fixed: Fixed) -> Newest:
    """The frame of this number, as it is seen at the k-th tick."""
    lens, c, points = twin.lens[0], fixed.dials[0], np.empty((2, 2))
    exposure = int(np.round(number * lens.period))
    if exposure < start.now:  # the tool may have been moved by hand before
        return Newest(-1, 0, 0, np.full(3, np.nan), np.full((2, 2), np.nan))
    p1 = position(rcm_of(c), joints_at(twin, exposure))
    put(points[0], project(lens, p1))
    put(points[1], project(lens, second_marker(fixed.shaft, p1)))
    for i in range(2):
        points[i] += noise[i]
        u, v = points[i, 0], points[i, 1]
        if not (0.0 <= u <= lens.width - 1.0 and 0.0 <= v <= lens.height - 1.0):
            fill(points[i], np.nan)
    j = (exposure - start.now) // c.period
    share = (exposure - start.now - j * c.period) / c.period
    later = twin.told[min(j + 1, k) % PAST]
    q = between(twin.told[j % PAST], later, share)
    return Newest(number, exposure, exposure + lens.late, q, points)
