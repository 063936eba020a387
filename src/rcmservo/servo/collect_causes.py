"""Detection of the causes that are present at a tick.

A cause is a reason why the servo does not simply move to the target, such as a lost marker. Its
detector reads the facts of the tick that are collected here.
"""

import numpy as np

from rcmservo.estimation.camera_fit_prediction import compute_pose_deviation
from rcmservo.geometry.kinematics import compute_point_distance, compute_position_tuple
from rcmservo.geometry.tool import compute_marker_ratio, compute_second_marker_tuple
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.safety.causes import find_causes
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.state_machine import DISABLED, FAULT, PAUSED, SERVO
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    make_rcm_struct,
    make_tool_struct,
)

ARRIVAL_DISTANCE_MM = 1.0
"""Distance of marker 1 from the target by the image, in mm, below which the tool has arrived."""

ASSUMED_TEACHING_FRAMES = 30.0
"""Number of frames that are assumed to be averaged in a target."""

NOISE_SIGMAS = 3.0
"""Standard deviations of pose noise that a distance may contain."""


@compiled
def collect_causes(tick: TickContext) -> int:
    """Return the set of causes that are present, as the bits of an integer."""
    stored, parameters = tick.stored, tick.parameters
    if stored.exploration_state.is_done:
        watch_target(tick)
    facts = TickFacts(
        observation=stored.monitor.observation,
        monitor=stored.monitor,
        estimate=stored.estimate,
        exploration_state=stored.exploration_state,
        progress=stored.decision,
        fit=stored.projection_fit,
        drive_requested=stored.decision.mode.phase not in (DISABLED, FAULT),
        paused=stored.decision.mode.phase == PAUSED,
        target_time=tick.setpoint.taught_at,
        estimator_failed=stored.estimator_result.has_failed,
        rcm=make_rcm_struct(parameters),
        period=parameters.period,
        gain=parameters.controller.gain,
        max_rcm_condition=parameters.imaged_rcm.max_condition,
        exploration=parameters.exploration,
        thresholds=parameters.thresholds,
    )
    return find_causes(facts)


@compiled
def watch_target(tick: TickContext) -> None:
    """Record since when the image and the joints disagree on the arrival at the target.

    They disagree if the image reports the target as reached, or leads the tool away from it again,
    but the joints differ from those at teaching by more than noise explains.
    """
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    decision, fit, q, q_d = stored.decision, stored.projection_fit, tick.observation.q, setpoint.q
    had_arrived = decision.has_arrived and not setpoint.is_new
    is_near = had_arrived or decision.remaining_mm < ARRIVAL_DISTANCE_MM
    if decision.mode.phase != SERVO or not is_near:
        decision.has_arrived, decision.mismatch_since = False, -1
        return
    allowed_mm = parameters.thresholds.max_target_mismatch
    if bound_marker_distance(q, q_d, parameters) < allowed_mm:
        decision.has_arrived, decision.mismatch_since = not setpoint.is_new, -1
        return
    distance_mm = compute_larger_marker_distance(q, q_d, parameters)
    if not distance_mm < allowed_mm:
        frames = max(min(fit.offset_weight[0], fit.offset_weight[1]), 1.0)
        noise_mm = compute_pose_deviation(fit, stored.estimate.p1, make_tool_struct(parameters))
        noise_mm *= np.sqrt(1.0 / frames + 1.0 / ASSUMED_TEACHING_FRAMES)
        allowed_mm += NOISE_SIGMAS * noise_mm
    decision.has_arrived = not setpoint.is_new and (had_arrived or distance_mm < allowed_mm)
    if not distance_mm - min(decision.remaining_mm, ARRIVAL_DISTANCE_MM) > allowed_mm:
        decision.mismatch_since = -1
    elif decision.mismatch_since < 0:
        decision.mismatch_since = tick.observation.now


@compiled
def compute_larger_marker_distance(q: Floats, q_d: Floats, parameters: KernelParameters) -> float:
    """Return the larger of the distances (mm) of both markers between the joints q and q_d (3,)."""
    rcm, shaft = make_rcm_struct(parameters), make_tool_struct(parameters)
    p1, p1_d = compute_position_tuple(rcm, q), compute_position_tuple(rcm, q_d)
    p2, p2_d = compute_second_marker_tuple(shaft, p1), compute_second_marker_tuple(shaft, p1_d)
    return max(compute_point_distance(p1, p1_d), compute_point_distance(p2, p2_d))


@compiled
def bound_marker_distance(q: Floats, q_d: Floats, parameters: KernelParameters) -> float:
    """Return an upper bound (mm) of `compute_larger_marker_distance`, in a fraction of its time.

    The direction of the tool turns by no more than the sum of the changes of the angles.
    """
    zero = parameters.rcm.zero
    rho, rho_d = q[2] + zero, q_d[2] + zero
    turn_rad = abs(q[0] - q_d[0]) + abs(q[1] - q_d[1])
    lever_ratio = max(compute_marker_ratio(make_tool_struct(parameters), (0.0, 0.0, rho)), 1.0)
    return lever_ratio * (abs(rho - rho_d) + max(abs(rho), abs(rho_d)) * turn_rad)
