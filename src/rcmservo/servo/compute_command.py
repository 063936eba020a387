"""Requested velocity and joint rates: by exploration, then by the control law."""

from rcmservo.control.drive_lag import follow_drives, lag_so_far, measure_lag
from rcmservo.control.exploration import CORNERS, arrived, begin, box, disagreement, face, towards
from rcmservo.control.exploration_planning import directed, plan
from rcmservo.control.saturated_controller import Heading, control, scaled
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.projection_prediction import features_motion, order
from rcmservo.geometry.features import wrapped
from rcmservo.geometry.kinematics import Point, blocked, point_at
from rcmservo.geometry.tool import fastest_point
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import put
from rcmservo.safety.innovation import sound
from rcmservo.safety.state_machine import ACQUIRE, SERVO
from rcmservo.servo.kernel_parameters import KernelParameters, TickContext, rcm_of, shaft_of
from rcmservo.servo.reset import request_rest, restart_stall_rule
from rcmservo.servo.state import Workspace
from rcmservo.servo.update_estimate import FRAME_UPDATES

MAX_CONDITION_RATIO = 0.5
"""Largest condition of eq. (16) at the end of exploration, as a ratio of its limit: the imaged RCM
must remain known afterwards."""


@compiled
def compute_command(tick: TickContext, frame_result: int) -> None:
    """Compute the requested velocity of marker 1 and joint rates of this tick, before the gate."""
    decision, tour = tick.stored.decision, tick.stored.tour
    if tick.setpoint.is_new:
        restart_stall_rule(decision, tick.observation.now)
    if not tour.done:
        explore(tick, frame_result)
    if tour.done:
        compute_law_rates(tick, decision.mode.phase == SERVO)


@compiled
def compute_law_rates(tick: TickContext, is_servoing: bool) -> None:
    """Compute v and the joint rates by the control law, and record the decrease of the error.

    The law acts on the predicted error Δy + Ĵ (p₁(now) − p₁).
    """
    observation, parameters = tick.observation, tick.parameters
    estimate, decision, rcm = tick.stored.estimate, tick.stored.decision, rcm_of(parameters)
    law, thresholds = parameters.controller, parameters.thresholds
    q = (observation.q[0], observation.q[1], observation.q[2])
    p1 = point_at(rcm, q)
    predict_error(estimate, p1)
    law_result, error = evaluate_law(estimate, p1, parameters, tick.stored.workspace)
    speed = fastest_point(shaft_of(parameters), p1, law_result.v, law.tip)
    slower = max(1.0, speed / law.max_speed)
    for k in range(3):
        decision.v[k] = law_result.v[k] / slower
    horizon, share = thresholds.limit_horizon, thresholds.limit_share
    joint, rates = blocked(rcm, q, decision.v, parameters.gate.speed, horizon, share)
    decision.rates[0], decision.rates[1], decision.rates[2] = rates
    estimate.condition, decision.blocked = law_result.condition, joint
    decision.open = law_result.open if error > thresholds.small_error else 1.0
    decision.left = law_result.left / decision.open  # a damped law underestimates it
    peak = max(decision.peak, error)
    fall = min(thresholds.stall_fall, thresholds.stall_share * peak)
    if error < peak - fall or not is_servoing:
        peak, decision.peak_time = error, observation.now
    decision.peak = peak


@compiled
def predict_error(estimate: Estimate, p1: Point) -> None:
    """Predict the error Δy of [s r d] for marker 1 at p1 mm."""
    J, ahead = estimate.J_hat, estimate.ahead
    x, y, z = estimate.p1[0] - p1[0], estimate.p1[1] - p1[1], estimate.p1[2] - p1[2]
    for i in range(3):
        ahead[i] = estimate.delta[i] - (J[i, 0] * x + J[i, 1] * y + J[i, 2] * z)
    ahead[0] = wrapped(ahead[0])


@compiled
def evaluate_law(
    estimate: Estimate, p1: Point, parameters: KernelParameters, workspace: Workspace
) -> tuple[Heading, float]:
    """Return the result of the control law with marker 1 at p1 mm, and √(2V), on its features."""
    law, features, n = parameters.controller, parameters.features, parameters.features.dimension
    J, error, bounds = workspace.J[:n], workspace.error[:n], features.bounds[:n]
    x, y, z = estimate.p1[0] - p1[0], estimate.p1[1] - p1[1], estimate.p1[2] - p1[2]
    for k in range(n):
        slope, unit = estimate.law_jacobian[k], features.scale[k]
        ahead = estimate.law_error[k] - (slope[0] * x + slope[1] * y + slope[2] * z)
        error[k] = (wrapped(ahead) if features.angle[k] > 0.0 else ahead) / unit
        for i in range(3):
            J[k, i] = slope[i] / unit
    printed = parameters.printed_potential
    return control(J, error, bounds, printed, law.gain, law.max_condition, law.max_speed)


@compiled
def explore(tick: TickContext, frame_result: int) -> None:
    """Move from corner to corner until the estimate suffices for servoing."""
    tour, decision = tick.stored.tour, tick.stored.decision
    observation, parameters = tick.observation, tick.parameters
    settings, fastest = parameters.exploration, parameters.gate.speed
    thresholds, q, now = parameters.thresholds, observation.q, observation.now
    if decision.mode.phase != ACQUIRE or tour.no_room:
        request_rest(decision)
        return
    if not tour.begun:
        begin(tour, rcm_of(parameters), fastest, q, now, thresholds.least_room, settings)
        return
    follow_drives(tour, q, observation.q_time, observation.applied, fastest)
    if frame_result == FRAME_UPDATES and can_servo(tick):
        tour.done = True
        measure_lag(tour)
        return
    if arrived(tour, q):
        choose_next_corner(tick)
    lag = lag_so_far(tour, thresholds.drive_lag)
    put(decision.rates, towards(tour, fastest, q, lag, settings))


@compiled
def choose_next_corner(tick: TickContext) -> None:
    """Count the corner that the joints have reached and choose the next one.

    The next corner is that of the present round. After the least number of corners it is the one
    that is most informative on the direction to the target.
    """
    stored, parameters, target = tick.stored, tick.parameters, tick.setpoint.points
    tour, fit, settings = stored.tour, stored.projection_fit, parameters.exploration
    rcm, shaft = rcm_of(parameters), shaft_of(parameters)
    tour.visits += 1
    if tour.visits % len(CORNERS) == 0:
        box(tour, rcm, parameters.gate.speed, 0.0, settings)
    face(tour)
    if tour.visits < settings.legs:
        return
    if not directed(fit, stored.estimate.p1, target, shaft, settings):
        plan(tour, fit, rcm, shaft, tick.observation.q, target, settings.reach)


@compiled
def can_servo(tick: TickContext) -> bool:
    """Return True if the estimate suffices for servoing.

    The direction to the target is certain enough, an Ĵ that does not come from the fit agrees with
    it, and the fit gives the markers in their order along the tool.
    """
    estimate, fit, parameters = tick.stored.estimate, tick.stored.projection_fit, tick.parameters
    settings, shaft = parameters.exploration, shaft_of(parameters)
    if tick.stored.tour.visits < settings.legs:
        return False
    if not directed(fit, estimate.p1, tick.setpoint.points, shaft, settings):
        return False
    if not sound(fit, parameters.thresholds):
        return False
    if not estimate.rcm_condition <= MAX_CONDITION_RATIO * parameters.imaged_rcm.max_condition:
        return False
    if estimate.rcm_condition > 0.0:
        J = scaled(features_motion(fit, estimate.p1, estimate.points, estimate.o_c, shaft))
        if not disagreement(scaled(estimate.J_hat), J) <= settings.tolerance:
            return False
    return order(fit) > 0.0
