"""The law where there is an estimate, and all that is wrong at a tick, as a set of causes."""

from rcmservo.compiled import compiled
from rcmservo.guard.causes import Cause
from rcmservo.guard.faults import arm_faults, camera_faults, loop_faults
from rcmservo.guard.states import DISABLED, FAULT, PAUSED, SERVO
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Told, Watch
from rcmservo.loops import all_finite, largest, minus, product, put
from rcmservo.method.controller import control, scaled
from rcmservo.method.exploration import Exploring, overdue
from rcmservo.method.features import difference
from rcmservo.method.kinematics import blocked, position
from rcmservo.method.tool import Shaft, second_marker
from rcmservo.servo.dials import Asked, Dials, Fixed, rcm_of
from rcmservo.servo.state import Decision, Estimate, Parts

ESTIMATE_NOT_FINITE, RCM_UNKNOWN = Cause.ESTIMATE_NOT_FINITE.bit, Cause.RCM_UNKNOWN.bit
ESTIMATE_LARGE, SINGULAR = Cause.ESTIMATE_LARGE.bit, Cause.SINGULAR.bit
NEARLY_SINGULAR, DIVERGED = Cause.NEARLY_SINGULAR.bit, Cause.DIVERGED.bit
STALLED, STALE, TARGET_OLD = Cause.STALLED.bit, Cause.STALE.bit, Cause.TARGET_OLD.bit
NO_ROOM, SWAPPED, NOT_EXPLORED = Cause.NO_ROOM.bit, Cause.SWAPPED.bit, Cause.NOT_EXPLORED.bit
LIMITS = (Cause.JOINT_1_LIMIT.bit, Cause.JOINT_2_LIMIT.bit, Cause.JOINT_3_LIMIT.bit)


@compiled
def decide(s: Parts, seen: Told, asked: Asked, fixed: Fixed) -> int:
    """Head for the target by the law, where there is an estimate; the causes that are there at this
    tick."""
    w, e, tour, d = s
    c, t = fixed.dials[0], fixed.thresholds[0]
    on = d.phase not in (DISABLED, FAULT)
    found = arm_faults(w, seen, on, rcm_of(c), t) | loop_faults(w, seen, c.period, t)
    found |= camera_faults(w, seen, rcm_of(c), t)
    if not all_finite(e.J_hat):
        found |= ESTIMATE_NOT_FINITE
    if d.phase == PAUSED and seen.frame < 0:
        found |= STALE  # nothing was seen that it could go on from
    if asked.shown < d.moved:
        found |= TARGET_OLD
    if not tour.done:
        return found | tour_faults(e, tour, seen.now, fixed)
    steer(e, d, seen, d.phase == SERVO, c, t)
    return found | estimate_faults(w, e, c, t) | way_faults(d, seen.now, c, t)


@compiled
def steer(e: Estimate, d: Decision, seen: Told, servoing: bool, c: Dials, t: Thresholds) -> None:
    """The law on Δy + Ĵ (p₁(now) − p₁), and how it gets on."""
    rcm = rcm_of(c)
    put(e.ahead, difference(e.delta, product(e.J_hat, minus(e.p1, position(rcm, seen.q)))))
    v, condition, error = control(
        e.J_hat, e.ahead, c.bounds, c.printed, c.gain, c.max_condition, c.max_speed
    )
    joint, rates = blocked(rcm, seen.q, v, c.fastest, t.limit_horizon, t.limit_share)
    put(d.v, v)
    put(d.rates, rates)
    e.condition, d.blocked = condition, joint
    peak = max(d.peak, error)
    if error < peak - min(t.stall_fall, t.stall_share * peak) or not servoing:
        peak, d.peak_time = error, seen.now
    d.peak = peak


@compiled
def estimate_faults(w: Watch, e: Estimate, c: Dials, t: Thresholds) -> int:
    """What is wrong with the estimate."""
    found = 0 if e.rcm_condition <= c.rcm_condition else RCM_UNKNOWN
    if not largest(scaled(e.J_hat)) <= t.largest:
        found |= ESTIMATE_LARGE
    if not e.condition < c.max_condition:
        found |= SINGULAR
    elif not e.condition < t.nearly_singular * c.max_condition:
        found |= NEARLY_SINGULAR
    if w.wrong >= t.disagreements:
        found |= DIVERGED
    return found


@compiled
def way_faults(d: Decision, now: int, c: Dials, t: Thresholds) -> int:
    """What stands in the way to the target."""
    found = LIMITS[d.blocked] if d.blocked >= 0 else 0
    patience = max(t.stall_time, t.stall_gains / c.gain)
    if d.peak > t.stall_error and now - d.peak_time > patience * 1e9:
        found |= STALLED
    return found


@compiled
def tour_faults(e: Estimate, tour: Exploring, now: int, fixed: Fixed) -> int:
    """What is wrong while exploring."""
    if tour.no_room:
        return NO_ROOM
    if not overdue(tour, now, fixed.exploration[0]):
        return 0
    return SWAPPED if out_of_order(e, fixed.shaft) else NOT_EXPLORED


@compiled
def out_of_order(e: Estimate, shaft: Shaft) -> bool:
    """Whether marker 1 stands beyond marker 2 as seen from o_c, though its tool has it nearer the
    RCM."""
    along, far, outwards, p2 = 0.0, 0.0, 0.0, second_marker(shaft, e.p1)
    for i in range(2):
        first, second = e.points[0, i] - e.o_c[i], e.points[1, i] - e.o_c[i]
        along += first * second
        far += second * second
    for i in range(3):
        outwards += e.p1[i] * (p2[i] - e.p1[i])
    return along > far and outwards > 0.0
