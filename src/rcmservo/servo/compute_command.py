"""Velocity of marker 1 and joint rates: by the law where there is an estimate, else by the first
motion.
"""

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
from rcmservo.servo.reset import restart, stand
from rcmservo.servo.state import Workspace
from rcmservo.servo.update_estimate import LEARN

SURELY = 0.5
"""Ratio of its limit that the condition of eq. (16) has at most at the end of an exploration: it
must stay known."""


@compiled
def compute_command(tick: TickContext, news: int) -> None:
    """Write the velocity of marker 1 and the joint rates of this tick, before the gate."""
    d, tour = tick.stored.decision, tick.stored.tour
    if tick.setpoint.is_new:
        restart(d, tick.observation.now)
    if not tour.done:
        explore(tick, news)
    if tour.done:
        steer(tick, d.mode.phase == SERVO)


@compiled
def steer(tick: TickContext, servoing: bool) -> None:
    """Apply the law to Δy + Ĵ (p₁(now) − p₁), and record how the error falls."""
    observation, parameters = tick.observation, tick.parameters
    e, d, rcm = tick.stored.estimate, tick.stored.decision, rcm_of(parameters)
    law, t = parameters.controller, parameters.thresholds
    q = (observation.q[0], observation.q[1], observation.q[2])
    p1 = point_at(rcm, q)
    predict_error(e, p1)
    heading, error = head(e, p1, parameters, tick.stored.work)
    speed = fastest_point(shaft_of(parameters), p1, heading.v, law.tip)
    slower = max(1.0, speed / law.max_speed)
    for k in range(3):
        d.v[k] = heading.v[k] / slower
    joint, rates = blocked(rcm, q, d.v, parameters.gate.speed, t.limit_horizon, t.limit_share)
    d.rates[0], d.rates[1], d.rates[2] = rates
    e.condition, d.blocked = heading.condition, joint
    d.open = heading.open if error > t.small_error else 1.0
    d.left = heading.left / d.open  # of a damped law that is less than the distance
    peak = max(d.peak, error)
    if error < peak - min(t.stall_fall, t.stall_share * peak) or not servoing:
        peak, d.peak_time = error, observation.now
    d.peak = peak


@compiled
def predict_error(e: Estimate, p1: Point) -> None:
    """Write Δy of [s r d] as predicted for marker 1 at p1 mm."""
    J, x, y, z = e.J_hat, e.p1[0] - p1[0], e.p1[1] - p1[1], e.p1[2] - p1[2]
    for i in range(3):
        e.ahead[i] = e.delta[i] - (J[i, 0] * x + J[i, 1] * y + J[i, 2] * z)
    e.ahead[0] = wrapped(e.ahead[0])


@compiled
def head(
    e: Estimate, p1: Point, parameters: KernelParameters, work: Workspace
) -> tuple[Heading, float]:
    """Return the law's answer with marker 1 at p1 mm, and √(2V), on its feature vector."""
    law, features, n = parameters.controller, parameters.features, parameters.features.dimension
    J, error, bounds = work.J[:n], work.error[:n], features.bounds[:n]
    x, y, z = e.p1[0] - p1[0], e.p1[1] - p1[1], e.p1[2] - p1[2]
    for k in range(n):
        slope, unit = e.law_jacobian[k], features.scale[k]
        ahead = e.law_error[k] - (slope[0] * x + slope[1] * y + slope[2] * z)
        error[k] = (wrapped(ahead) if features.angle[k] > 0.0 else ahead) / unit
        for i in range(3):
            J[k, i] = slope[i] / unit
    printed = parameters.printed_potential
    return control(J, error, bounds, printed, law.gain, law.max_condition, law.max_speed)


@compiled
def explore(tick: TickContext, news: int) -> None:
    """Move from corner to corner, until the estimate is known well enough to go to the target."""
    tour, d = tick.stored.tour, tick.stored.decision
    seen, parameters = tick.observation, tick.parameters
    x, fastest, t = parameters.exploration, parameters.gate.speed, parameters.thresholds
    if d.mode.phase != ACQUIRE or tour.no_room:
        stand(d)
        return
    if not tour.begun:
        begin(tour, rcm_of(parameters), fastest, seen.q, seen.now, t.least_room, x)
        return
    follow_drives(tour, seen.q, seen.q_time, seen.applied, fastest)
    if news == LEARN and known(tick):
        tour.done = True
        measure_lag(tour)
        return
    if arrived(tour, seen.q):
        visit(tick)
    lag = lag_so_far(tour, t.drive_lag)
    put(d.rates, towards(tour, fastest, seen.q, lag, x))


@compiled
def visit(tick: TickContext) -> None:
    """Count the corner that the joints are at, and choose the next: of this round, or, once the
    least number is visited, the one that tells most of the direction to the target.
    """
    stored, parameters, target = tick.stored, tick.parameters, tick.setpoint.points
    tour, fit, x = stored.tour, stored.prospect, parameters.exploration
    rcm, shaft = rcm_of(parameters), shaft_of(parameters)
    tour.visits += 1
    if tour.visits % len(CORNERS) == 0:
        box(tour, rcm, parameters.gate.speed, 0.0, x)
    face(tour)
    if tour.visits >= x.legs and not directed(fit, stored.estimate.p1, target, shaft, x):
        plan(tour, fit, rcm, shaft, tick.observation.q, target, x.reach)


@compiled
def known(tick: TickContext) -> bool:
    """Return whether there is an estimate to servo with: the direction to the target is certain
    enough, an Ĵ that is not made of the fit agrees with it, and the markers stand in their
    order.
    """
    e, fit, parameters = tick.stored.estimate, tick.stored.prospect, tick.parameters
    x, shaft = parameters.exploration, shaft_of(parameters)
    if tick.stored.tour.visits < x.legs:
        return False
    if not directed(fit, e.p1, tick.setpoint.points, shaft, x):
        return False
    if not sound(fit, parameters.thresholds):
        return False
    if not e.rcm_condition <= SURELY * parameters.imaged_rcm.max_condition:
        return False
    if e.rcm_condition > 0.0:
        J = scaled(features_motion(fit, e.p1, e.points, e.o_c, shaft))
        if not disagreement(scaled(e.J_hat), J) <= x.tolerance:
            return False
    return order(fit) > 0.0
