"""One closed loop as one compiled function: the twin of the laboratory and the live servo's own
step. It repeats `loop.run` because ten thousand loops in a minute leave no time for Python between
two ticks.
"""

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.geometry.kinematics import Point, apart, point_at
from rcmservo.geometry.tool import Shaft, second_point
from rcmservo.interfaces import Dropped, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, put
from rcmservo.numerics.structs import Rows
from rcmservo.safety.monitor_state import ObservationRow
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    rcm_of,
    shaft_of,
)
from rcmservo.servo.setpoint import Setpoint, store_setpoint
from rcmservo.servo.state import Stored
from rcmservo.servo.tick import step
from rcmservo.sim.camera_kernels import CameraStruct, project_markers_into
from rcmservo.study.plant_kernel import (
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

STILL = np.zeros(3)


class Start(NamedTuple):
    """What a closed loop begins with.

    Parameters
    ----------
    stored : Rows[Stored]
        State of the servo.
    memory : Any
        Memory of its estimator.
    parameters : Rows[KernelParameters]
        Settings of the servo's parts.
    kernel : Any
        Compiled form of its estimator.
    now : int
        When the first tick is, ns.
    """

    stored: Rows[Stored]
    memory: Any
    parameters: Rows[KernelParameters]
    kernel: Any
    now: int


class Goal(NamedTuple):
    """What a closed loop goes to.

    Parameters
    ----------
    points : Floats
        The target's markers (2, 2) raw px.
    q : Floats
        The joints (3,) then, as the arm told them.
    p2 : Floats
        Where marker 2 truly was, (3,) mm.
    """

    points: Floats
    q: Floats
    p2: Floats


class Course(NamedTuple):
    """What a closed loop leaves, of every tick.

    Parameters
    ----------
    error : Floats
        (n,) mm from marker 2 to where it was shown.
    phase : NDArray[np.int8]
        (n,) places in Phase.
    cause : NDArray[np.int8]
        (n,) places in Cause.
    """

    error: Floats
    phase: NDArray[np.int8]
    cause: NDArray[np.int8]


@compiled
def closed_loop(
    start: Start, laboratory: Rows[Twin], shown: Goal, noise: Floats, trace: Course
) -> None:
    """Servo for as many ticks as the trace is long, and write over what it begins with.

    `noise` (frames, 2, 2) px is added to what the camera sees in each frame from the first tick on.
    """
    stored, fixed, twin = start.stored[0], start.parameters[0], laboratory[0]
    now = TickContext(stored, stored.watch.observation, stored.setpoint, fixed)
    memory, d, (errors, phases, causes) = start.memory, stored.decision, trace
    store_setpoint(stored.setpoint, Setpoint(shown.points, shown.q, start.now, True, 0, STILL))
    begin(twin, now.observation, start.now)
    skipped = newest(twin.pace, start.now)
    for k in range(len(errors)):
        time = start.now + k * fixed.period
        advance(twin, time)
        count(twin, twin.told[k % PAST])
        number = newest(twin.pace, time)
        if number > max(now.observation.frame, skipped):
            take_frame(twin, now, number, noise[number - skipped - 1], start.now, k)
        read_joints(twin, now.observation, time, k)
        now.setpoint.is_new = k == 0
        memory = step(start.kernel, memory, now)
        take(twin, d.command.rates, d.command.enabled)
        p2 = second_point(shaft_of(fixed), point_at(rcm_of(fixed), twin.drives.q))
        errors[k] = apart(p2, (shown.p2[0], shown.p2[1], shown.p2[2]))
        phases[k], causes[k] = d.mode.phase, d.mode.cause


@compiled
def begin(twin: Twin, observation: ObservationRow, now: int) -> None:
    """Begin at `now` ns, before the first frame."""
    place(twin, now)
    observation.frame, observation.exposure, observation.arrival = -1, 0, 0
    observation.dropped, observation.recorded = NOT_DROPPED, True
    fill(observation.q_exposure, np.nan)
    fill(observation.points, np.nan)


@compiled
def read_joints(twin: Twin, observation: ObservationRow, now: int, k: int) -> None:
    """Observe the arm at the k-th tick."""
    observation.now, observation.q_time, observation.enabled = now, now, twin.drives.on
    put(observation.q, twin.told[k % PAST])
    put(observation.applied, twin.drives.applied)


@compiled
def take_frame(
    twin: Twin, tick: TickContext, number: int, noise: Floats, start: int, k: int
) -> None:
    """Observe the frame of this number at the k-th tick; none that was exposed before the `start`,
    ns, as the tool may have been moved by hand before.
    """
    fixed, observation, pace = tick.parameters, tick.observation, twin.pace
    exposure = int(np.round(number * pace.period))
    if exposure < start:
        return
    joints_at(twin, exposure, observation.q_exposure)
    p1 = point_at(rcm_of(fixed), observation.q_exposure)
    see(twin.lens, shaft_of(fixed), p1, noise, observation.points)
    j = (exposure - start) // fixed.period
    share = (exposure - start - j * fixed.period) / fixed.period
    told = twin.told
    between(told[j % PAST], told[min(j + 1, k) % PAST], share, observation.q_exposure)
    observation.frame, observation.exposure = number, exposure
    observation.arrival = exposure + pace.late


@compiled
def see(lens: CameraStruct, shaft: Shaft, p1: Point, noise: Floats, points: Floats) -> None:
    """Write both markers (2, 2) px with their noise; NaN where one is not in the picture."""
    project_markers_into(lens, shaft, p1, points)
    for i in range(2):
        u, v = points[i, 0] + noise[i, 0], points[i, 1] + noise[i, 1]
        within = 0.0 <= u <= lens.width - 1.0 and 0.0 <= v <= lens.height - 1.0
        points[i, 0], points[i, 1] = (u, v) if within else (np.nan, np.nan)
