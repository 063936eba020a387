"""The twin of the simulated laboratory, for studies: arm and point camera as compiled functions.

The drives are those of `rcmservo.sim.arm`: delay, first-order lag, deadband, counting encoders and
hard stops. What MuJoCo adds, the tool's inertia, is left out: its velocity drives follow within a
millisecond. The camera is that of `rcmservo.sim.cameras`: the same lens, the same times.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import fill, put
from rcmservo.rows import Row, Rows, flag, real, reals, whole

STEP = 1_000_000
"""ns of one step of the arm."""

PAST = 1024
"""Steps of the arm that are kept, and answers of it: as far back as a frame may be exposed."""

QUEUE = 128
"""Commands that may be on their way to the drives."""


class Lens(Row):
    """The true camera."""

    width: int = whole("px", "of the picture")
    height: int = whole("px", "of the picture")
    focal: float = real("px", "its focal length")
    centre: Floats = reals(2, "px", "the principal point")
    distortion: Floats = reals(2, "", "k1 and k2")
    fold: float = real("", "the slope beyond which the lens folds")
    rotation: Floats = reals((3, 3), "", "from world axes to camera axes")
    place: Floats = reals(3, "mm", "the camera's centre in the world")
    period: float = real("ns", "from frame to frame")
    late: int = whole("ns", "from a frame's exposure to its arrival")


class Drives(Row):
    """The arm, and what of its drives does not change."""

    time: int = whole("ns", "now")
    q: Floats = reals(3, "rad, rad, mm", "the joints as they are")
    rates: Floats = reals(3, "rad/s, rad/s, mm/s", "their rates, lagging behind")
    wanted: Floats = reals(3, "rad/s, rad/s, mm/s", "the rates that the drives obey")
    applied: Floats = reals(3, "rad/s, rad/s, mm/s", "the rates last taken of a command")
    on: bool = flag("whether the drives are on")
    first: int = whole("", "the oldest command on its way")
    last: int = whole("", "the newest command on its way, and one more")
    delay: int = whole("ns", "from a command to its being obeyed")
    follow: float = real("", "share of the way to the wanted rate in one step")
    deadband: Floats = reals(3, "rad/s, rad/s, mm/s", "below which a joint stays still")
    encoder: Floats = reals(3, "rad, rad, mm", "of one count")
    lower: Floats = reals(3, "rad, rad, mm", "the hard stops")
    upper: Floats = reals(3, "rad, rad, mm", "the hard stops")


class Twin(NamedTuple):
    """A laboratory that runs."""

    drives: Rows[Drives]
    """The arm."""
    queue: Floats
    """(QUEUE, 3) rates on their way to the drives."""
    due: NDArray[np.int64]
    """(QUEUE,) ns, when each is obeyed."""
    past: Floats
    """(PAST, 3) the joints at each of the last steps."""
    told: Floats
    """(PAST, 3) the joints as the arm told them at the last ticks."""
    lens: Rows[Lens]
    """The camera."""


@compiled
def advance(twin: Twin, until: int) -> None:
    """Let time pass until a moment (ns), to the nearest step."""
    a = twin.drives[0]
    while a.time + STEP // 2 < until:
        a.time += STEP
        if not a.on:
            a.first = a.last
            fill(a.wanted, 0.0)
            fill(a.rates, 0.0)
        while a.first < a.last and twin.due[a.first % QUEUE] <= a.time:
            put(a.wanted, twin.queue[a.first % QUEUE])
            a.first += 1
        for i in range(3):
            a.rates[i] += a.follow * (a.wanted[i] - a.rates[i])
            if abs(a.rates[i]) > a.deadband[i]:
                there = a.q[i] + a.rates[i] * STEP * 1e-9
                a.q[i] = min(max(there, a.lower[i]), a.upper[i])
        put(twin.past[a.time // STEP % PAST], a.q)


@compiled
def place(twin: Twin, now: int) -> None:
    """The drives go on at `now` ns, with the tool at rest as if it had always been there."""
    a = twin.drives[0]
    a.time, a.on = now, True
    for i in range(PAST):
        put(twin.past[i], a.q)


@compiled
def take(twin: Twin, rates: Floats, on: bool) -> None:
    """Take a command."""
    a = twin.drives[0]
    a.on = a.on and on
    for i in range(3):
        a.applied[i] = rates[i] if a.on else 0.0
    put(twin.queue[a.last % QUEUE], a.applied)
    twin.due[a.last % QUEUE] = a.time + a.delay
    a.last += 1


@compiled
def between(earlier: Floats, later: Floats, share: float) -> Floats:
    """The joints (3,) a share of the way from one place to another."""
    out = np.empty(3)
    for i in range(3):
        out[i] = earlier[i] + share * (later[i] - earlier[i])
    return out


@compiled
def joints_at(twin: Twin, time: int) -> Floats:
    """The joints (3,) as they were at a moment (ns) of the last second."""
    step = time // STEP
    share = (time - step * STEP) / STEP
    return between(twin.past[step % PAST], twin.past[(step + 1) % PAST], share)


@compiled
def counted(twin: Twin) -> Floats:
    """The joints (3,) as the encoders count them now."""
    a, q = twin.drives[0], np.empty(3)
    for i in range(3):
        q[i] = np.round(a.q[i] / a.encoder[i]) * a.encoder[i]
    return q


@compiled
def newest(lens: Lens, now: int) -> int:
    """Number of the newest frame that has arrived, -1 before the first."""
    return max(int(np.floor((now - lens.late) / lens.period + 1e-6)), -1)


@compiled
def project(lens: Lens, p: Floats) -> Floats:
    """Where a point p (3,) mm appears, (2,) px; NaN outside of the picture."""
    x, out = np.zeros(3), np.full(2, np.nan)
    for i in range(3):
        for k in range(3):
            x[i] += lens.rotation[i, k] * (p[k] - lens.place[k])
    u, v = x[0] / x[2], x[1] / x[2]
    r = np.sqrt(u * u + v * v)
    stretch = 1.0 + lens.distortion[0] * r**2 + lens.distortion[1] * r**4
    if x[2] > 0.0 and r < lens.fold:
        out[0] = lens.focal * stretch * u + lens.centre[0]
        out[1] = lens.focal * stretch * v + lens.centre[1]
    return out
