"""Closed loop of a study as one compiled function: the compiled plant and the live servo's step.

It does what `rcmservo.loop.servo_loop` does for one tick after the other. It is compiled because
10,000 loops per minute leave no time for Python code between two ticks.
"""

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.geometry.kinematics import Point, compute_point_distance
from rcmservo.interfaces import DropReason, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, fill
from rcmservo.numerics.structs import Rows
from rcmservo.safety.monitor_state import ObservationRow
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    make_rcm_struct,
    make_tool_struct,
)
from rcmservo.servo.setpoint import Setpoint, store_setpoint
from rcmservo.servo.state import StoredState
from rcmservo.servo.tick import step
from rcmservo.sim.camera_kernels import CameraStruct, project
from rcmservo.sim.imperfect_markers import (
    BEND_INTERVAL_NS,
    compute_focus,
    compute_row_delay,
    place_marker,
)
from rcmservo.study.plant_kernel import (
    HISTORY_LENGTH,
    PlantStruct,
    advance_plant,
    compute_newest_frame,
    interpolate_history,
    interpolate_joints,
    queue_command,
    read_encoders,
    reset_plant,
)

NOT_DROPPED = cast(DropReason, DropReason.NONE.value)
"""`DropReason.NONE` for compiled functions."""

NO_JOG = np.zeros(3)
"""Joint rates requested by the operator: none."""


class InitialConditions(NamedTuple):
    """Servo and its state before the first tick of a closed loop.

    Parameters
    ----------
    stored : Rows[StoredState]
        State of the servo.
    memory : Any
        Memory of its estimator.
    parameters : Rows[KernelParameters]
        Settings of the servo's parts.
    kernel : Any
        Compiled form of its estimator.
    now : int
        Time of the first tick, ns.
    """

    stored: Rows[StoredState]
    memory: Any
    parameters: Rows[KernelParameters]
    kernel: Any
    now: int


class StudyGoal(NamedTuple):
    """Target of a closed loop, and the true position that belongs to it.

    Parameters
    ----------
    points : Floats
        Markers of the target (2, 2), raw px.
    q : Floats
        Joints (3,) that the arm reported while the target was taught; rad, rad, mm.
    p2 : Floats
        True position of marker 2 at the target (3,), mm.
    """

    points: Floats
    q: Floats
    p2: Floats


class LoopTrace(NamedTuple):
    """Record of a closed loop: one entry per tick.

    Parameters
    ----------
    error : Floats
        Distance (n,) from marker 2 to its position at the target, mm.
    phase : NDArray[np.int8]
        Index (n,) of the state machine's phase in `PHASES`.
    cause : NDArray[np.int8]
        Index (n,) of the cause in `CAUSES`.
    """

    error: Floats
    phase: NDArray[np.int8]
    cause: NDArray[np.int8]


@compiled
def run_closed_loop(
    start: InitialConditions,
    plants: Rows[PlantStruct],
    goal: StudyGoal,
    noise: Floats,
    trace: LoopTrace,
) -> None:
    """Run one tick for each entry of the trace; overwrite the initial conditions and the plant.

    `noise` (frames, 2, 2) px is added to the markers of each frame from the first tick on.
    """
    stored, parameters, plant = start.stored[0], start.parameters[0], plants[0]
    tick = TickContext(stored, stored.monitor.observation, stored.setpoint, parameters)
    memory, decision, (errors, phases, causes) = start.memory, stored.decision, trace
    store_setpoint(stored.setpoint, Setpoint(goal.points, goal.q, start.now, True, 0, NO_JOG))
    reset_plant_and_observation(plant, tick.observation, start.now)
    earlier_frame = compute_newest_frame(plant.frame_timing, start.now)
    for k in range(len(errors)):
        now = start.now + k * parameters.period
        advance_plant(plant, now)
        read_encoders(plant, plant.readings[k % HISTORY_LENGTH])
        frame = compute_newest_frame(plant.frame_timing, now)
        if frame > max(tick.observation.frame, earlier_frame):
            observe_frame(plant, tick, frame, noise[frame - earlier_frame - 1], start.now, k)
        observe_joints(plant, tick.observation, now, k)
        tick.setpoint.is_new = k == 0
        memory = step(start.kernel, memory, tick)
        queue_command(plant, decision.command.rates, decision.command.enabled)
        p2 = place_marker_now(plant, tick, now, 1)
        errors[k] = compute_point_distance(p2, (goal.p2[0], goal.p2[1], goal.p2[2]))
        phases[k], causes[k] = decision.mode.phase, decision.mode.cause


@compiled
def place_marker_now(plant: PlantStruct, tick: TickContext, now: int, k: int) -> Point:
    """Return the true position of marker k at the present time `now` (ns), mm."""
    rcm, shaft = make_rcm_struct(tick.parameters), make_tool_struct(tick.parameters)
    errors, q, q_before = plant.imperfections, plant.drives.tool_q, plant.q_before
    if errors.is_any:
        interpolate_history(plant, now - BEND_INTERVAL_NS, q_before)
    return place_marker(errors, rcm, shaft, q, q_before, now, k)


@compiled
def reset_plant_and_observation(plant: PlantStruct, observation: ObservationRow, now: int) -> None:
    """Reset the plant at the time `now` (ns), and the observation to the one before any frame."""
    reset_plant(plant, now)
    observation.frame, observation.exposure, observation.arrival = -1, 0, 0
    observation.drop_reason, observation.recorded = NOT_DROPPED, True
    fill(observation.q_exposure, np.nan)
    fill(observation.points, np.nan)


@compiled
def observe_joints(plant: PlantStruct, observation: ObservationRow, now: int, k: int) -> None:
    """Write the joints and rates that the arm reports at the k-th tick into the observation."""
    drives = plant.drives
    observation.now, observation.q_time, observation.enabled = now, now, drives.enabled
    copy_into(observation.q, plant.readings[k % HISTORY_LENGTH])
    copy_into(observation.applied, drives.applied)


@compiled
def observe_frame(
    plant: PlantStruct, tick: TickContext, frame: int, noise: Floats, start: int, k: int
) -> None:
    """Write the markers of a frame, given by its number, into the observation of the k-th tick.

    A frame exposed before `start` (ns) is ignored: the tool may have been moved by hand before.
    """
    parameters, observation, timing = tick.parameters, tick.observation, plant.frame_timing
    exposure = int(np.round(frame * timing.period))
    arrival, stamp = exposure + timing.latency, exposure + plant.imperfections.stamp_error
    if stamp < start:
        return
    image_markers(plant, tick, exposure, observation.points)
    add_noise(plant.camera, noise, observation.points)
    # the markers follow from the true joints, but the servo knows only the arm's readings
    readings, j = plant.readings, (stamp - start) // parameters.period
    fraction = (stamp - start - j * parameters.period) / parameters.period
    earlier, later = readings[j % HISTORY_LENGTH], readings[min(j + 1, k) % HISTORY_LENGTH]
    interpolate_joints(earlier, later, fraction, observation.q_exposure)
    observation.frame, observation.exposure, observation.arrival = frame, stamp, arrival


@compiled
def image_markers(plant: PlantStruct, tick: TickContext, exposure: int, points: Floats) -> None:
    """Write both markers (2, 2) px without noise, each at the exposure of its row."""
    errors, camera = plant.imperfections, plant.camera
    for k in range(2):
        points[k, 0], points[k, 1] = image_marker_at(plant, tick, exposure, k)
        if errors.read_out > 0.0:
            time = exposure + compute_row_delay(errors, points[k, 1], camera.height)
            points[k, 0], points[k, 1] = image_marker_at(plant, tick, time, k)


@compiled
def image_marker_at(
    plant: PlantStruct, tick: TickContext, time: int, k: int
) -> tuple[float, float]:
    """Return the image (u, v) px of marker k at `time` ns."""
    rcm, shaft = make_rcm_struct(tick.parameters), make_tool_struct(tick.parameters)
    errors, camera, q, q_before = plant.imperfections, plant.camera, plant.q_then, plant.q_before
    interpolate_history(plant, time, q)
    if errors.is_any:
        interpolate_history(plant, time - BEND_INTERVAL_NS, q_before)
    u, v = project(camera, place_marker(errors, rcm, shaft, q, q_before, time, k))
    if not errors.focus > 0.0:
        return u, v
    focus, u_0, v_0 = compute_focus(errors, time), camera.centre[0], camera.centre[1]
    return u_0 + focus * (u - u_0), v_0 + focus * (v - v_0)


@compiled
def add_noise(camera: CameraStruct, noise: Floats, points: Floats) -> None:
    """Add the noise to both markers (2, 2) px; NaN for a marker outside the image."""
    for i in range(2):
        u, v = points[i, 0] + noise[i, 0], points[i, 1] + noise[i, 1]
        is_visible = 0.0 <= u <= camera.width - 1.0 and 0.0 <= v <= camera.height - 1.0
        points[i, 0], points[i, 1] = (u, v) if is_visible else (np.nan, np.nan)
