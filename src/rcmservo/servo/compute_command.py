"""Requested velocity of marker 1 and joint rates: by exploration, then by the controller."""

import numpy as np

from rcmservo.control.drive_response import (
    add_response_reading,
    estimate_lag_so_far,
    finish_response_measurement,
    select_gain,
    select_lag,
)
from rcmservo.control.exploration import (
    CONFIRMING_CORNERS,
    CORNERS,
    compute_rates_to_corner,
    compute_relative_difference,
    is_at_corner,
    set_next_corner,
    set_round,
    start_exploration,
)
from rcmservo.control.exploration_planning import direction_is_known, plan_corner
from rcmservo.control.latency_compensation import predict_component, predict_error
from rcmservo.control.saturated_controller import (
    ControllerOutput,
    compute_controller_output,
    scale_rows,
)
from rcmservo.control.tool_speed_cap import (
    cap_joint_rates,
    cap_tool_speed,
    choose_speed_cap,
)
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.camera_fit_prediction import (
    compute_fitted_features_jacobian,
    compute_marker_order_score,
)
from rcmservo.geometry.features import wrap_angle
from rcmservo.geometry.kinematics import (
    Point,
    compute_point_distance,
    compute_position_tuple,
    find_blocking_joint,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.safety.innovation import is_plausible_fit
from rcmservo.safety.state_machine import ACQUIRE, HOLD, SERVO
from rcmservo.servo.collect_causes import compare_target_with_fit
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    make_rcm_struct,
    make_tool_struct,
)
from rcmservo.servo.state import Workspace, request_rest, restart_stall_rule
from rcmservo.servo.target_gap import end_approach
from rcmservo.servo.update_estimate import FRAME_UPDATES

RETURN_END_MM = 1.0
"""Distance (mm) from the goal at which a return by the joints ends."""

MAX_RCM_UNCERTAINTY = 0.5
"""Largest uncertainty of o_c by eq. (16) at the end of exploration, as a ratio of its limit.

The margin lets the imaged RCM remain known during the motion that follows.
"""


@compiled
def compute_command(tick: TickContext, frame_result: int) -> None:
    """Compute the requested velocity of marker 1 and joint rates of this tick, before the gate."""
    decision, exploration = tick.stored.decision, tick.stored.exploration_state
    if tick.setpoint.is_new:
        restart_stall_rule(decision, tick.observation.now)
        decision.has_approached = False
    if not exploration.is_done:
        explore(tick, frame_result)
    if exploration.is_done:
        compute_servoing_rates(tick, decision.mode.phase == SERVO)
    for i in range(3):  # so that the joints move as requested
        decision.rates[i] /= select_gain(exploration, i)


@compiled
def compute_servoing_rates(tick: TickContext, is_servoing: bool) -> None:
    """Compute v and the joint rates by the controller, and record the decrease of the error.

    The controller acts on the error that is predicted for the present joints, or for later ones of
    drives with a long lag.
    """
    observation, parameters = tick.observation, tick.parameters
    estimate, decision, rcm = (
        tick.stored.estimate,
        tick.stored.decision,
        make_rcm_struct(parameters),
    )
    controller, thresholds = parameters.controller, parameters.thresholds
    q = (observation.q[0], observation.q[1], observation.q[2])
    p1 = compute_position_tuple(rcm, predict_joints_after_lag(tick))
    predict_error(estimate, p1)
    output, error = evaluate_controller(estimate, p1, parameters, tick.stored.workspace)
    if continue_return(tick, p1):
        output, is_servoing = approach_goal(decision.goal, p1, output, controller.gain), False
    max_speed = choose_speed_cap(controller, decision.is_unchecked)
    cap_tool_speed(
        decision.v, output.v, make_tool_struct(parameters), p1, controller.tip, max_speed
    )
    horizon_s, fraction = thresholds.limit_horizon, thresholds.limit_speed_fraction
    joint, rates = find_blocking_joint(
        rcm, q, decision.v, parameters.gate.speed, horizon_s, fraction
    )
    decision.rates[0], decision.rates[1], decision.rates[2] = rates
    estimate.condition, decision.blocked_joint = output.condition, joint
    is_checked = error > thresholds.min_checked_error
    decision.reducible_fraction = output.reducible_fraction if is_checked else 1.0
    # a damped motion is shorter than the distance to the target
    decision.remaining_mm = output.distance_to_target / decision.reducible_fraction
    if is_servoing and decision.aims_at_approach:
        end_approach(tick)
    largest_error = max(decision.reference_error, error)
    decrease = min(thresholds.stall_decrease, thresholds.stall_decrease_fraction * largest_error)
    if error < largest_error - decrease or not is_servoing:
        largest_error, decision.reference_time = error, observation.now
    decision.reference_error = largest_error


@compiled
def continue_return(tick: TickContext, p1: Point) -> bool:
    """Return True while the tool at p1 mm returns to the goal by the joints."""
    decision, setpoint = tick.stored.decision, tick.setpoint
    goal = decision.goal[0], decision.goal[1], decision.goal[2]
    is_moving = decision.mode.phase in (SERVO, HOLD) and not setpoint.is_new
    decision.has_returned = decision.has_returned and not setpoint.is_new
    is_far = compute_point_distance(p1, goal) > RETURN_END_MM
    decision.returns = decision.returns and is_moving and is_far
    return decision.returns


@compiled
def approach_goal(
    goal: Floats, p1: Point, output: ControllerOutput, gain: float
) -> ControllerOutput:
    """Return v = k (goal − p₁) in place of the output of the controller with the gain k."""
    x, y, z = goal[0] - p1[0], goal[1] - p1[1], goal[2] - p1[2]
    distance = np.sqrt(x * x + y * y + z * z)
    return ControllerOutput((gain * x, gain * y, gain * z), output.condition, 1.0, distance)


@compiled
def predict_joints_after_lag(tick: TickContext) -> Point:
    """Return the joints (3,) that the present rates lead to in the time t ≥ 0.

    With the gain k the tool overshoots if the drives have a lag above 1/(e k), less a tick. t is
    what the lag exceeds that by.
    """
    parameters = tick.parameters
    q, rates = tick.observation.q, tick.stored.monitor.predicted_rates[0]
    lag_s = select_lag(tick.stored.exploration_state, parameters.thresholds.drive_lag)
    allowed_s = 1.0 / (np.e * parameters.controller.gain) - parameters.period * 1e-9
    t = max(lag_s - allowed_s, 0.0)
    return q[0] + t * rates[0], q[1] + t * rates[1], q[2] + t * rates[2]


@compiled
def evaluate_controller(
    estimate: Estimate, p1: Point, parameters: KernelParameters, workspace: Workspace
) -> tuple[ControllerOutput, float]:
    """Return the controller's output with marker 1 at p1 mm, and √(2V) of eq. (32)."""
    controller, features = parameters.controller, parameters.features
    n = features.dimension
    J, error, bounds = workspace.J[:n], workspace.error[:n], features.bounds[:n]
    for k in range(n):
        slope, unit = estimate.controlled_jacobian[k], features.scale[k]
        predicted = predict_component(estimate.controlled_error[k], slope, estimate.p1, p1)
        error[k] = (wrap_angle(predicted) if features.angle[k] > 0.0 else predicted) / unit
        for i in range(3):
            J[k, i] = slope[i] / unit
    follows_paper, gain = parameters.uses_paper_potential, controller.gain
    return compute_controller_output(
        J, error, bounds, follows_paper, gain, controller.max_condition, controller.max_speed
    )


@compiled
def explore(tick: TickContext, frame_result: int) -> None:
    """Move from corner to corner until the estimate suffices for servoing."""
    exploration, decision = tick.stored.exploration_state, tick.stored.decision
    observation, parameters, q = tick.observation, tick.parameters, tick.observation.q
    settings, max_rates = parameters.exploration, parameters.gate.speed
    if exploration.has_begun:
        add_response_reading(exploration, q, observation.q_time, observation.applied)
    if decision.mode.phase != ACQUIRE or exploration.has_no_room:
        request_rest(decision)
        return
    if not exploration.has_begun:
        rcm, min_room = make_rcm_struct(parameters), parameters.thresholds.min_exploration_room
        start_exploration(exploration, rcm, max_rates, q, observation.now, min_room, settings)
        return
    if frame_result == FRAME_UPDATES:
        exploration.fit_is_known = fit_suffices(tick)
        exploration.disagreement = compare_with_fit(tick) if exploration.fit_is_known else np.nan
        is_confirmed = exploration.fit_is_known and confirm_target(tick)
        exploration.is_done = exploration.disagreement <= settings.tolerance and is_confirmed
    if exploration.is_done:
        finish_response_measurement(exploration, max_rates)
        return
    if is_at_corner(exploration, exploration.next_corner, q):
        choose_next_corner(tick)
    lag_s = estimate_lag_so_far(exploration, parameters.thresholds.drive_lag, max_rates)
    rates = compute_rates_to_corner(exploration, max_rates, q, lag_s, settings)
    rcm, tool = make_rcm_struct(parameters), make_tool_struct(parameters)
    tip, max_speed = parameters.controller.tip, parameters.controller.max_speed
    cap_joint_rates(decision.rates, rates, rcm, tool, q, tip, max_speed)


@compiled
def confirm_target(tick: TickContext) -> bool:
    """Return True if the fit agrees with the target, or contradicts it after four more corners.

    Errors of an arm contradict a target too while the fit has few frames.
    """
    exploration, settings = tick.stored.exploration_state, tick.parameters.exploration
    compare_target_with_fit(tick)
    least_corners = settings.min_corners + CONFIRMING_CORNERS
    exploration.is_conclusive = exploration.visited_corners >= least_corners
    return exploration.is_conclusive or not tick.stored.decision.is_implausible


@compiled
def choose_next_corner(tick: TickContext) -> None:
    """Count the corner that the joints have reached and choose the next one.

    The next corner is that of the present round. After the minimal number of corners it is the one
    that is most informative on the direction to the target.
    """
    stored, parameters, target = tick.stored, tick.parameters, tick.setpoint.points
    exploration, fit = stored.exploration_state, stored.projection_fit
    settings = parameters.exploration
    rcm, shaft = make_rcm_struct(parameters), make_tool_struct(parameters)
    exploration.visited_corners += 1
    if exploration.visited_corners % len(CORNERS) == 0:
        set_round(exploration, rcm, parameters.gate.speed, 0.0, settings)
    set_next_corner(exploration)
    if exploration.visited_corners < settings.min_corners:
        return
    if not direction_is_known(fit, stored.estimate.p1, target, shaft, settings):
        q, max_leg = tick.observation.q, settings.max_leg_length
        plan_corner(exploration, fit, rcm, shaft, q, target, max_leg)


@compiled
def fit_suffices(tick: TickContext) -> bool:
    """Return True if the projection fit suffices for servoing.

    The direction to the target must be known, and the fit must be that of a camera and have the
    markers in their order along the tool.
    """
    estimate, fit, parameters = tick.stored.estimate, tick.stored.projection_fit, tick.parameters
    settings, shaft = parameters.exploration, make_tool_struct(parameters)
    if tick.stored.exploration_state.visited_corners < settings.min_corners:
        return False
    if not direction_is_known(fit, estimate.p1, tick.setpoint.points, shaft, settings):
        return False
    return is_plausible_fit(fit, parameters.thresholds) and compute_marker_order_score(fit) > 0.0


@compiled
def compare_with_fit(tick: TickContext) -> float:
    """Return the difference of Ĵ from that of the projection fit, as a fraction of the latter.

    It is 0 if Ĵ comes from the fit, and inf while the lines do not determine the imaged RCM.
    """
    estimate, fit, parameters = tick.stored.estimate, tick.stored.projection_fit, tick.parameters
    if estimate.rcm_condition == 0.0:
        return 0.0
    if not estimate.rcm_uncertainty <= MAX_RCM_UNCERTAINTY:
        return np.inf
    points, o_c, shaft = estimate.points, estimate.o_c, make_tool_struct(parameters)
    J = compute_fitted_features_jacobian(fit, estimate.p1, points, o_c, shaft)
    return compute_relative_difference(scale_rows(estimate.J_hat), scale_rows(J))
