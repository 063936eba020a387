"""One closed loop as one compiled function: the twin of the laboratory and the live servo's own
step. It repeats `loop.run` because ten thousand loops in a minute leave no time for Python between
two ticks."""

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled
from rcmservo.interfaces import Dropped, Floats, ObservationStruct
from rcmservo.loops import fill
from rcmservo.memory import scratch, unowned
from rcmservo.method.kinematics import Point, apart, point_at
from rcmservo.method.tool import Shaft, second_point
from rcmservo.rows import Rows
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    Setpoint,
    TickContext,
    rcm_of,
    shaft_of,
)
from rcmservo.servo.state import Stored
from rcmservo.servo.tick import step
from rcmservo.sim.camera_kernels import Lens, picture
from rcmservo.study.twin import (
    PAST,
    Twin,
    advance,
    between,
    count,
    joints_at,
    newest,
    place,
    take,
)

NOT_DROPPED = cast(Dropped, Dropped.NONE.value)
"""`Dropped.NONE` in compiled functions."""


class Start(NamedTuple):
    """What a closed loop begins with."""

    stored: Rows[Stored]
    """State of the servo."""
    memory: Any
    """Memory of its estimator."""
    parameters: Rows[KernelParameters]
    """Settings of the servo's parts."""
    kernel: Any
    """Compiled form of its estimator."""
    now: int
    """When the first tick is, ns."""


class Goal(NamedTuple):
    """What a closed loop goes to."""

    points: Floats
    """The target's markers (2, 2) raw px."""
    q: Floats
    """The joints (3,) then, as the arm told them."""
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


@compiled
def closed_loop(start: Start, twin: Twin, shown: Goal, noise: Floats, trace: Course) -> None:
    """Servo for as many ticks as the trace is long, and write over what it begins with.

    `noise` (frames, 2, 2) px is added to what the camera sees in each frame from the first tick on.
    """
    start, twin, shown = unowned(start), unowned(twin), unowned(shown)
    noise, trace = unowned(noise), unowned(trace)
    memory, fixed, d = start.memory, start.parameters, start.stored[0].decision
    period, arm = fixed[0].period, twin.drives[0]
    place(twin, start.now)
    skipped = newest(twin.pace[0], start.now)
    frame, still = Newest(-1, 0, 0), scratch(3)
    fill(still, 0.0)
    for k in range(len(trace.error)):
        now = start.now + k * period
        advance(twin, now)
        q = twin.told[k % PAST]
        count(twin, q)
        number = newest(twin.pace[0], now)
        if number > max(frame.number, skipped):
            frame = taken(twin, number, noise[number - skipped - 1], start, k)
        observation = ObservationStruct(
            now=now,
            q=q,
            q_time=now,
            enabled=arm.on,
            applied=arm.applied,
            frame=frame.number,
            exposure=frame.exposure,
            arrival=frame.arrival,
            q_exposure=twin.exposed,
            points=twin.points,
            dropped=NOT_DROPPED,
            recorded=True,
        )
        setpoint = Setpoint(
            points=shown.points, q=shown.q, shown=start.now, is_new=k == 0, request=0, jog=still
        )
        context = TickContext(start.stored[0], observation, setpoint, fixed[0])
        memory = step(start.kernel, memory, context)
        take(twin, d.command.rates, d.command.enabled)
        p2 = second_point(shaft_of(fixed[0]), point_at(rcm_of(fixed[0]), arm.q))
        trace.error[k] = apart(p2, (shown.p2[0], shown.p2[1], shown.p2[2]))
        trace.phase[k], trace.cause[k] = d.mode.phase, d.mode.cause


@compiled
def taken(twin: Twin, number: int, noise: Floats, start: Start, k: int) -> Newest:
    """The frame of this number, as it is seen at the k-th tick."""
    pace, fixed, q = twin.pace[0], start.parameters[0], scratch(3)
    exposure = int(np.round(number * pace.period))
    if exposure < start.now:  # the tool may have been moved by hand before
        return Newest(-1, 0, 0)
    joints_at(twin, exposure, q)
    see(twin.lens[0], shaft_of(fixed), point_at(rcm_of(fixed), q), noise, twin.points)
    j = (exposure - start.now) // fixed.period
    share = (exposure - start.now - j * fixed.period) / fixed.period
    between(twin.told[j % PAST], twin.told[min(j + 1, k) % PAST], share, twin.exposed)
    return Newest(number, exposure, exposure + pace.late)


@compiled
def see(lens: Lens, shaft: Shaft, p1: Point, noise: Floats, points: Floats) -> None:
    """Write both markers (2, 2) px with their noise; NaN where one is not in the picture."""
    picture(lens, shaft, p1, points)
    for i in range(2):
        u, v = points[i, 0] + noise[i, 0], points[i, 1] + noise[i, 1]
        within = 0.0 <= u <= lens.width - 1.0 and 0.0 <= v <= lens.height - 1.0
        points[i, 0], points[i, 1] = (u, v) if within else (np.nan, np.nan)
