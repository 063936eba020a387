"""Compiled plant of a study: the arm and the point camera of the simulator as compiled functions.

The drives are those of `rcmservo.sim.arm`: delay, first-order lag, deadband, inertia, quantising
encoders and hard stops. The camera is that of `rcmservo.sim.cameras`, with the same lens and the
same timing. With the same noise, a closed loop agrees with the simulated laboratory to a few
1e-6 mm. The inertia delays the arm by less than a millisecond, but a decision of the servo can
depend on that: without it, the final error of one loop in seven differed by more than 5 %.
"""

import numpy as np
from numpy.typing import NDArray

from rcmservo.constraints import Triple
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, fill
from rcmservo.numerics.structs import Row, flag, part, real, reals, whole, wholes
from rcmservo.sim.camera_kernels import CameraStruct
from rcmservo.sim.imperfect_markers import ImperfectionsStruct, follow_with_backlash
from rcmservo.study.inertia import InertiaStruct, LinearisedDynamics, linearise_dynamics

ARM_STEP_NS = 1_000_000
"""Integration step of the arm, ns."""

HISTORY_LENGTH = 1024
"""Steps of the arm, and encoder readings, that are stored: the oldest that a frame may show."""

QUEUE_LENGTH = 128
"""Largest number of commands that the drives have not executed yet."""


class FrameTimingStruct(Row):
    """Timing of the camera's frames."""

    period: float = real("ns", "time between two frames")
    latency: int = whole("ns", "from the exposure of a frame to its arrival")


class DrivesStruct(Row):
    """State of the arm and constants of its drives."""

    time: int = whole("ns", "present time")
    q: Floats = reals(3, "rad, rad, mm", "true joints at the motors")
    tool_q: Floats = reals(3, "rad, rad, mm", "true joints of the tool, after backlash")
    speeds: Floats = reals(3, "rad/s, rad/s, mm/s", "true joint rates")
    lagged_rates: Floats = reals(3, "rad/s, rad/s, mm/s", "rates that the drives regulate to")
    target_rates: Floats = reals(3, "rad/s, rad/s, mm/s", "rates before the first-order lag")
    applied: Floats = reals(3, "rad/s, rad/s, mm/s", "rates of the last command")
    enabled: bool = flag("the drives are enabled")
    queue_begin: int = whole("", "number of the oldest command in the queue")
    queue_end: int = whole("", "number of the next command")
    delay: int = whole("ns", "from a command to its execution")
    lag_gain: float = real("", "fraction of the difference to the target rate that a step removes")
    deadband: Floats = reals(3, "rad/s, rad/s, mm/s", "lagged rates up to which a joint rests")
    stiction: Floats = reals(3, "rad/s, rad/s, mm/s", "the same of a joint at rest, if larger")
    encoder: Floats = reals(3, "rad, rad, mm", "encoder resolution: joint motion of one count")
    encoder_offset: Floats = reals(3, "rad, rad, mm", "reported joint minus true joint")
    rate_scale: Floats = reals(3, "", "executed rate divided by commanded rate")
    report: Floats = reals(3, "rad, rad, mm", "joints that the arm reports")
    report_time: int = whole("ns", "time at which they were measured")
    lower: Floats = reals(3, "rad, rad, mm", "lower hard stops")
    upper: Floats = reals(3, "rad, rad, mm", "upper hard stops")
    inertia: InertiaStruct = part(InertiaStruct, "inertias and drive gains")


class PlantStruct(Row):
    """State of the compiled plant.

    It is one row, so that compiled functions do not count references to its arrays.
    """

    drives: DrivesStruct = part(DrivesStruct, "the arm")
    queued_rates: Floats = reals((QUEUE_LENGTH, 3), "rad/s, rad/s, mm/s", "pending commands")
    due_times: NDArray[np.int64] = wholes(QUEUE_LENGTH, "ns", "execution time of each command")
    joint_history: Floats = reals((HISTORY_LENGTH, 3), "rad, rad, mm", "tool_q, by arm step")
    q_then: Floats = reals(3, "rad, rad, mm", "tool_q at an exposure")
    q_before: Floats = reals(3, "rad, rad, mm", "tool_q just before")
    readings: Floats = reals((HISTORY_LENGTH, 3), "rad, rad, mm", "reported joints, by tick")
    camera: CameraStruct = part(CameraStruct, "projection of the camera")
    frame_timing: FrameTimingStruct = part(FrameTimingStruct, "timing of the frames")
    imperfections: ImperfectionsStruct = part(ImperfectionsStruct, "of arm, tool and camera")


@compiled
def advance_plant(plant: PlantStruct, until: int) -> None:
    """Integrate to the step nearest to the time `until` (ns), at most one tick ahead.

    A stretch of steps ends where the drives execute a command, which changes their target rates.
    """
    drives = plant.drives
    steps_left = (until - drives.time + ARM_STEP_NS // 2 - 1) // ARM_STEP_NS
    dynamics = linearise_at_midpoint(drives, steps_left)
    while steps_left > 0:
        if not drives.enabled:
            drives.queue_begin = drives.queue_end
            fill(drives.target_rates, 0.0)
            fill(drives.lagged_rates, 0.0)
        while (
            drives.queue_begin < drives.queue_end
            and plant.due_times[drives.queue_begin % QUEUE_LENGTH] <= drives.time + ARM_STEP_NS
        ):
            set_drive_target(drives, plant.queued_rates[drives.queue_begin % QUEUE_LENGTH])
            drives.queue_begin += 1
        steps = steps_left
        if drives.queue_begin < drives.queue_end:
            due_time = plant.due_times[drives.queue_begin % QUEUE_LENGTH]
            steps = min(steps_left, max((due_time - drives.time - 1) // ARM_STEP_NS, 1))
        integrate_joints(drives, dynamics, plant.joint_history, steps)
        move_tool(plant, steps)
        drives.time += steps * ARM_STEP_NS
        steps_left -= steps


@compiled
def move_tool(plant: PlantStruct, steps: int) -> None:
    """Let the tool follow the motors through the backlash, in the newest `steps` of the history."""
    drives, history, errors = plant.drives, plant.joint_history, plant.imperfections
    if not errors.is_any:
        copy_into(drives.tool_q, drives.q)
        return
    first = drives.time // ARM_STEP_NS + 1
    for k in range(steps):
        joints = history[(first + k) % HISTORY_LENGTH]
        follow_with_backlash(errors, joints, drives.tool_q)
        copy_into(joints, drives.tool_q)


@compiled
def linearise_at_midpoint(drives: DrivesStruct, steps: int) -> LinearisedDynamics:
    """Return the equations about the middle of the motion during the next `steps`."""
    half_s = 0.5 * steps * ARM_STEP_NS * 1e-9
    inner = 1 - drives.inertia.outer_joint
    z = drives.q[2] + half_s * drives.speeds[2]
    angle = drives.q[inner] + half_s * drives.speeds[inner]
    return linearise_dynamics(drives.inertia, z, angle, ARM_STEP_NS * 1e-9)


@compiled
def set_drive_target(drives: DrivesStruct, rates: Floats) -> None:
    """Execute a command: set the target rates (3,), each with the scale error of its motor."""
    for i in range(3):
        drives.target_rates[i] = drives.rate_scale[i] * rates[i]


@compiled
def integrate_joints(
    drives: DrivesStruct, dynamics: LinearisedDynamics, history: Floats, steps: int
) -> None:
    """Integrate the joints over `steps` with constant target rates, and store them in the history.

    The suffixes _o, _i and _s stand for outer hinge, inner hinge and slide; q are joints, v rates,
    r lagged rates, u target rates, d deadbands, s stictions, k drive gains and g the step factors
    h/(M + h k). Scalars instead of arrays stay in the processor's registers.
    """
    h, lag_gain, o = ARM_STEP_NS * 1e-9, drives.lag_gain, drives.inertia.outer_joint
    i, index = 1 - o, drives.time // ARM_STEP_NS
    (q_o, q_i, q_s), (v_o, v_i, v_s) = order_joints(drives.q, o), order_joints(drives.speeds, o)
    r_o, r_i, r_s = order_joints(drives.lagged_rates, o)
    u_o, u_i, u_s = order_joints(drives.target_rates, o)
    d_o, d_i, d_s = order_joints(drives.deadband, o)
    s_o, s_i, s_s = order_joints(drives.stiction, o)
    low_o, low_i, low_s = order_joints(drives.lower, o)
    high_o, high_i, high_s = order_joints(drives.upper, o)
    k_o, k_i, k_s = order_joints(drives.inertia.drive_gain, o)
    (g_o, g_i, g_s), (g_o_z, g_i_z) = dynamics.step_factor, dynamics.step_factor_by_z
    g_o_angle = dynamics.step_factor_by_angle
    (c_a, c_b, c_e), (a_z, b_z, e_z) = dynamics.coriolis, dynamics.coriolis_by_z
    a_angle, b_angle = dynamics.coriolis_by_angle
    z, angle = q_s - dynamics.z, q_i - dynamics.inner_angle
    g_o, g_i = g_o + g_o_z * z + g_o_angle * angle, g_i + g_i_z * z
    c_a, c_b, c_e = c_a + a_z * z + a_angle * angle, c_b + b_z * z + b_angle * angle, c_e + e_z * z
    for _ in range(steps):
        v_o_squared = v_o * v_o
        c_o = (v_o + v_o) * (c_a * v_i + c_b * v_s)
        c_i = (v_s + v_s) * c_e * v_i - c_a * v_o_squared
        c_s = -(c_b * v_o_squared + c_e * v_i * v_i)
        r_o, r_i = r_o + lag_gain * (u_o - r_o), r_i + lag_gain * (u_i - r_i)
        r_s += lag_gain * (u_s - r_s)
        v_o += g_o * (k_o * (apply_deadband(r_o, v_o, d_o, s_o) - v_o) - c_o)
        v_i += g_i * (k_i * (apply_deadband(r_i, v_i, d_i, s_i) - v_i) - c_i)
        v_s += g_s * (k_s * (apply_deadband(r_s, v_s, d_s, s_s) - v_s) - c_s)
        dq_o, dq_i, dq_s = v_o * h, v_i * h, v_s * h
        g_o, g_i = g_o + g_o_z * dq_s + g_o_angle * dq_i, g_i + g_i_z * dq_s
        c_a, c_b = c_a + a_z * dq_s + a_angle * dq_i, c_b + b_z * dq_s + b_angle * dq_i
        c_e += e_z * dq_s
        q_o, q_i = min(max(q_o + dq_o, low_o), high_o), min(max(q_i + dq_i, low_i), high_i)
        q_s = min(max(q_s + dq_s, low_s), high_s)
        index = (index + 1) & (HISTORY_LENGTH - 1)
        history[index, o], history[index, i], history[index, 2] = q_o, q_i, q_s
    drives.q[o], drives.q[i], drives.q[2] = q_o, q_i, q_s
    drives.speeds[o], drives.speeds[i], drives.speeds[2] = v_o, v_i, v_s
    drives.lagged_rates[o], drives.lagged_rates[i], drives.lagged_rates[2] = r_o, r_i, r_s


@compiled
def apply_deadband(rate: float, speed: float, deadband: float, stiction: float) -> float:
    """Return the rate, or 0 inside the deadband, and for a joint at rest inside the stiction."""
    rests = abs(rate) <= deadband or (abs(rate) <= stiction and abs(speed) <= deadband)
    return 0.0 if rests else rate


@compiled
def order_joints(values: Floats, outer: int) -> Triple:
    """Return the values (3,) in the order outer hinge, inner hinge, slide."""
    return values[outer], values[1 - outer], values[2]


@compiled
def reset_plant(plant: PlantStruct, now: int) -> None:
    """Enable the drives at the time `now` (ns), with a history in which the arm always rested."""
    drives = plant.drives
    drives.time, drives.enabled = now, True
    drives.report_time = now - plant.imperfections.report_period
    for i in range(HISTORY_LENGTH):
        copy_into(plant.joint_history[i], drives.tool_q)


@compiled
def queue_command(plant: PlantStruct, rates: Floats, enabled: bool) -> None:
    """Queue the rates (3,) of a command; disabled drives stay disabled and apply zero."""
    drives = plant.drives
    drives.enabled = drives.enabled and enabled
    for i in range(3):
        drives.applied[i] = rates[i] if drives.enabled else 0.0
    copy_into(plant.queued_rates[drives.queue_end % QUEUE_LENGTH], drives.applied)
    plant.due_times[drives.queue_end % QUEUE_LENGTH] = drives.time + drives.delay
    drives.queue_end += 1


@compiled
def interpolate_joints(earlier: Floats, later: Floats, fraction: float, into: Floats) -> None:
    """Write the joints (3,) at a fraction of the distance from `earlier` to `later`."""
    for i in range(3):
        into[i] = earlier[i] + fraction * (later[i] - earlier[i])


@compiled
def interpolate_history(plant: PlantStruct, time: int, into: Floats) -> None:
    """Write the true joints (3,) at a time (ns) of the last second."""
    step = time // ARM_STEP_NS
    fraction = (time - step * ARM_STEP_NS) / ARM_STEP_NS
    history = plant.joint_history
    earlier, later = history[step % HISTORY_LENGTH], history[(step + 1) % HISTORY_LENGTH]
    interpolate_joints(earlier, later, fraction, into)


@compiled
def read_encoders(plant: PlantStruct, into: Floats) -> None:
    """Write the joints (3,) that the arm reports now."""
    drives = plant.drives
    if drives.time >= drives.report_time + plant.imperfections.report_period:
        for i in range(3):
            q, offset, encoder = drives.q[i], drives.encoder_offset[i], drives.encoder[i]
            drives.report[i] = np.round((q + offset) / encoder) * encoder
        drives.report_time = drives.time
    copy_into(into, drives.report)


@compiled
def compute_newest_frame(timing: FrameTimingStruct, now: int) -> int:
    """Return the number of the newest frame that has arrived at `now` (ns); -1 before the first."""
    return max(int(np.floor((now - timing.latency) / timing.period + 1e-6)), -1)
