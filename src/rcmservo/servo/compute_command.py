"""Requested velocity and joint rates: by exploration, then by the control law."""

from rcmservo.control.drive_lag import add_lag_reading, current_lag, finish_lag_measurement
from rcmservo.control.exploration import (
    CORNERS,
    is_at_next_corner,
    rates_to_corner,
    relative_difference,
    set_next_corner,
    set_round,
    start_exploration,
)
from rcmservo.control.exploration_planning import direction_is_known, plan_corner
from rcmservo.control.latency_compensation import predict_component, predict_error
from rcmservo.control.saturated_controller import LawResult, apply_law, scale_rows
from rcmservo.control.tool_speed_cap import cap_tool_speed
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.camera_fit_prediction import fitted_features_jacobian, marker_order_score
from rcmservo.geometry.features import wrap_angle
from rcmservo.geometry.kinematics import Point, compute_position_tuple, find_blocking_joint
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into
from rcmservo.safety.innovation import is_plausible_fit
from rcmservo.safety.state_machine import ACQUIRE, SERVO
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    rcm_struct_of,
    tool_struct_of,
)
from rcmservo.servo.reset import request_rest, restart_stall_rule
from rcmservo.servo.state import Workspace
from rcmservo.servo.update_estimate import FRAME_UPDATES

MAX_CONDITION_RATIO = 0.5
"""Largest condition of eq. (16) at the end of exploration, as a ratio of its limit: the imaged RCM
must remain known afterwards."""


@compiled
def compute_command(tick: TickContext, frame_result: int) -> None:
    """Compute the requested velocity of marker 1 and joint rates of this tick, before the gate."""
    decision, exploration_state = tick.stored.decision, tick.stored.exploration_state
    if tick.setpoint.is_new:
        restart_stall_rule(decision, tick.observation.now)
    if not exploration_state.is_done:
        explore(tick, frame_result)
    if exploration_state.is_done:
        compute_law_rates(tick, decision.mode.phase == SERVO)


@compiled
def compute_law_rates(tick: TickContext, is_servoing: bool) -> None:
    """Compute v and the joint rates by the control law, and record the decrease of the error.

    The law acts on the predicted error Δy + Ĵ (p₁(now) − p₁).
    """
    observation, parameters = tick.observation, tick.parameters
    estimate, decision, rcm = tick.stored.estimate, tick.stored.decision, rcm_struct_of(parameters)
    law, thresholds = parameters.controller, parameters.thresholds
    q = (observation.q[0], observation.q[1], observation.q[2])
    p1 = compute_position_tuple(rcm, q)
    predict_error(estimate, p1)
    law_result, error = evaluate_law(estimate, p1, parameters, tick.stored.workspace)
    cap_tool_speed(decision.v, law_result.v, tool_struct_of(parameters), p1, law)
    horizon, fraction = thresholds.limit_horizon, thresholds.limit_speed_fraction
    joint, rates = find_blocking_joint(rcm, q, decision.v, parameters.gate.speed, horizon, fraction)
    decision.rates[0], decision.rates[1], decision.rates[2] = rates
    estimate.condition, decision.blocked_joint = law_result.condition, joint
    decision.reducible_fraction = (
        law_result.reducible_fraction if error > thresholds.min_checked_error else 1.0
    )
    decision.remaining_mm = (
        law_result.distance_to_target / decision.reducible_fraction
    )  # a damped law underestimates it
    peak = max(decision.reference_error, error)
    fall = min(thresholds.stall_decrease, thresholds.stall_decrease_fraction * peak)
    if error < peak - fall or not is_servoing:
        peak, decision.reference_time = error, observation.now
    decision.reference_error = peak


@compiled
def evaluate_law(
    estimate: Estimate, p1: Point, parameters: KernelParameters, workspace: Workspace
) -> tuple[LawResult, float]:
    """Return the result of the control law with marker 1 at p1 mm, and √(2V), on its features."""
    law, features, n = parameters.controller, parameters.features, parameters.features.dimension
    J, error, bounds = workspace.J[:n], workspace.error[:n], features.bounds[:n]
    for k in range(n):
        slope, unit = estimate.law_jacobian[k], features.scale[k]
        predicted = predict_component(estimate.law_error[k], slope, estimate.p1, p1)
        error[k] = (wrap_angle(predicted) if features.angle[k] > 0.0 else predicted) / unit
        for i in range(3):
            J[k, i] = slope[i] / unit
    printed = parameters.printed_potential
    return apply_law(J, error, bounds, printed, law.gain, law.max_condition, law.max_speed)


@compiled
def explore(tick: TickContext, frame_result: int) -> None:
    """Move from corner to corner until the estimate suffices for servoing."""
    exploration_state, decision = tick.stored.exploration_state, tick.stored.decision
    observation, parameters = tick.observation, tick.parameters
    settings, fastest = parameters.exploration, parameters.gate.speed
    thresholds, q, now = parameters.thresholds, observation.q, observation.now
    if decision.mode.phase != ACQUIRE or exploration_state.has_no_room:
        request_rest(decision)
        return
    if not exploration_state.has_begun:
        start_exploration(
            exploration_state,
            rcm_struct_of(parameters),
            fastest,
            q,
            now,
            thresholds.min_exploration_room,
            settings,
        )
        return
    add_lag_reading(exploration_state, q, observation.q_time, observation.applied, fastest)
    if frame_result == FRAME_UPDATES and can_servo(tick):
        exploration_state.is_done = True
        finish_lag_measurement(exploration_state)
        return
    if is_at_next_corner(exploration_state, q):
        choose_next_corner(tick)
    lag = current_lag(exploration_state, thresholds.drive_lag)
    copy_into(decision.rates, rates_to_corner(exploration_state, fastest, q, lag, settings))


@compiled
def choose_next_corner(tick: TickContext) -> None:
    """Count the corner that the joints have reached and choose the next one.

    The next corner is that of the present round. After the least number of corners it is the one
    that is most informative on the direction to the target.
    """
    stored, parameters, target = tick.stored, tick.parameters, tick.setpoint.points
    exploration_state, fit, settings = (
        stored.exploration_state,
        stored.projection_fit,
        parameters.exploration,
    )
    rcm, shaft = rcm_struct_of(parameters), tool_struct_of(parameters)
    exploration_state.visited_corners += 1
    if exploration_state.visited_corners % len(CORNERS) == 0:
        set_round(exploration_state, rcm, parameters.gate.speed, 0.0, settings)
    set_next_corner(exploration_state)
    if exploration_state.visited_corners < settings.min_corners:
        return
    if not direction_is_known(fit, stored.estimate.p1, target, shaft, settings):
        plan_corner(
            exploration_state, fit, rcm, shaft, tick.observation.q, target, settings.max_leg_length
        )


@compiled
def can_servo(tick: TickContext) -> bool:
    """Return True if the estimate suffices for servoing.

    The direction to the target is certain enough, an Ĵ that does not come from the fit agrees with
    it, and the fit gives the markers in their order along the tool.
    """
    estimate, fit, parameters = tick.stored.estimate, tick.stored.projection_fit, tick.parameters
    settings, shaft = parameters.exploration, tool_struct_of(parameters)
    if tick.stored.exploration_state.visited_corners < settings.min_corners:
        return False
    if not direction_is_known(fit, estimate.p1, tick.setpoint.points, shaft, settings):
        return False
    if not is_plausible_fit(fit, parameters.thresholds):
        return False
    if not estimate.rcm_condition <= MAX_CONDITION_RATIO * parameters.imaged_rcm.max_condition:
        return False
    if estimate.rcm_condition > 0.0:
        J = scale_rows(
            fitted_features_jacobian(fit, estimate.p1, estimate.points, estimate.o_c, shaft)
        )
        if not relative_difference(scale_rows(estimate.J_hat), J) <= settings.tolerance:
            return False
    return marker_order_score(fit) > 0.0
