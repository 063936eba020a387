"""The law where there is an estimate, and all that is wrong at a tick, as a set of causes."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.guard.causes import Cause
from rcmservo.guard.drift import drift_faults
from rcmservo.guard.faults import arm_faults, camera_faults, loop_faults
from rcmservo.guard.plausible import sound
from rcmservo.guard.states import DISABLED, FAULT, PAUSED, SERVO
from rcmservo.guard.watch import Watch
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.loops import all_finite, largest
from rcmservo.memory import scratch, scratch_table
from rcmservo.method.controller import MOST, Heading, control, scale
from rcmservo.method.exploration import Exploring, overdue
from rcmservo.method.features import SCALE, wrapped
from rcmservo.method.foresight import order, pose_deviation
from rcmservo.method.kinematics import Point, apart, blocked, point_at
from rcmservo.method.prospect import Prospect
from rcmservo.method.tool import fastest_point, second_point, stretch
from rcmservo.servo.kernel_parameters import Asked, KernelParameters, rcm_of, shaft_of
from rcmservo.servo.state import Decision, Estimate, Kept

ESTIMATE_NOT_FINITE, RCM_UNKNOWN = Cause.ESTIMATE_NOT_FINITE.bit, Cause.RCM_UNKNOWN.bit
ESTIMATE_LARGE, SINGULAR = Cause.ESTIMATE_LARGE.bit, Cause.SINGULAR.bit
NEARLY_SINGULAR, DIVERGED = Cause.NEARLY_SINGULAR.bit, Cause.DIVERGED.bit
ELSEWHERE, FROZEN = Cause.ELSEWHERE.bit, Cause.FROZEN.bit
STALLED, STALE, TARGET_OLD = Cause.STALLED.bit, Cause.STALE.bit, Cause.TARGET_OLD.bit
NO_ROOM, SWAPPED, NOT_EXPLORED = Cause.NO_ROOM.bit, Cause.SWAPPED.bit, Cause.NOT_EXPLORED.bit
LIMITS = (Cause.JOINT_1_LIMIT.bit, Cause.JOINT_2_LIMIT.bit, Cause.JOINT_3_LIMIT.bit)


CROSSED = -0.3
"""Order of the markers below which they are taken for each other."""

NEAR = 1.0
"""mm from the target, by the picture, up to which the tool counts as being there."""

SHOWN = 30.0
"""Frames that a target is taken to be the mean of."""

CERTAIN = 3.0
"""Standard deviations."""


@compiled
def decide(
    s: Kept, v: Prospect, seen: ObservationStruct, asked: Asked, fixed: KernelParameters
) -> int:
    """Head for the target by the law, where there is an estimate; the causes that are there at this
    tick."""
    w, e, tour, d = s.watch, s.estimate, s.tour, s.decision
    t = fixed.thresholds
    on = d.mode.phase not in (DISABLED, FAULT)
    found = arm_faults(w, seen, on, rcm_of(fixed), t) | loop_faults(w, seen, fixed.period, t)
    found |= camera_faults(w, seen, rcm_of(fixed), t)
    if not all_finite(e.J_hat):
        found |= ESTIMATE_NOT_FINITE
    if d.mode.phase == PAUSED and seen.frame < 0:
        found |= STALE  # nothing was seen that it could go on from
    if asked.shown < d.moved:
        found |= TARGET_OLD
    if not tour.done:
        return found | tour_faults(w, v, tour, seen.now, fixed)
    steer(e, d, seen, d.mode.phase == SERVO, fixed)
    stray(s, v, seen, asked, fixed)
    found |= drift_faults(w, t) | estimate_faults(w, e, fixed)
    if not sound(v, t):
        found |= DIVERGED
    return found | way_faults(d, seen.now, fixed)


@compiled
def steer(
    e: Estimate, d: Decision, seen: ObservationStruct, servoing: bool, fixed: KernelParameters
) -> None:
    """The law on Δy + Ĵ (p₁(now) − p₁), and how it gets on."""
    law, t, rcm = fixed.controller, fixed.thresholds, rcm_of(fixed)
    q = (seen.q[0], seen.q[1], seen.q[2])
    p1 = point_at(rcm, q)
    carry(e, p1)
    heading, error = head(e, p1, fixed)
    speed = fastest_point(shaft_of(fixed), p1, heading.v, law.tip)
    slower = max(1.0, speed / law.max_speed)
    for k in range(3):
        d.v[k] = heading.v[k] / slower
    joint, rates = blocked(rcm, q, d.v, fixed.gate.speed, t.limit_horizon, t.limit_share)
    d.rates[0], d.rates[1], d.rates[2] = rates
    e.condition, d.blocked = heading.condition, joint
    d.open = heading.open if error > t.small_error else 1.0
    d.left = heading.left / d.open  # of a damped law that is less than the way
    peak = max(d.peak, error)
    if error < peak - min(t.stall_fall, t.stall_share * peak) or not servoing:
        peak, d.peak_time = error, seen.now
    d.peak = peak


@compiled
def carry(e: Estimate, p1: Point) -> None:
    """Δy as predicted for marker 1 at p1 mm."""
    J, x, y, z = e.J_hat, e.p1[0] - p1[0], e.p1[1] - p1[1], e.p1[2] - p1[2]
    for i in range(3):
        e.ahead[i] = e.delta[i] - (J[i, 0] * x + J[i, 1] * y + J[i, 2] * z)
    e.ahead[0] = wrapped(e.ahead[0])


@compiled
def head(e: Estimate, p1: Point, fixed: KernelParameters) -> tuple[Heading, float]:
    """The law with marker 1 at p1 mm: on [s r d], or on the markers' four coordinates, and maybe
    both apparent radii, of which 10 px are one unit."""
    c, printed = fixed.controller, fixed.printed_potential
    if fixed.features > 3:
        n, px = fixed.features, SCALE[1]
        L, off, most = scratch_table(MOST, 3)[:n], scratch(MOST)[:n], scratch(MOST)[:n]
        for k in range(n):
            off[k], most[k] = e.off[k] / px, c.bounds[1] / px
            for i in range(3):
                L[k, i] = e.motion[k, i] / px
                off[k] -= L[k, i] * (e.p1[i] - p1[i])
        return control(L, off, most, printed, c.gain, c.max_condition, c.max_speed)
    J, delta, bounds = scratch_table(3, 3), scratch(3), scratch(3)
    scale(e.J_hat, J)
    for k in range(3):
        delta[k], bounds[k] = e.ahead[k] / SCALE[k], c.bounds[k] / SCALE[k]
    return control(J, delta, bounds, printed, c.gain, c.max_condition, c.max_speed)


@compiled
def stray(
    s: Kept, v: Prospect, seen: ObservationStruct, asked: Asked, fixed: KernelParameters
) -> None:
    """Whether the picture shows the tool at the target, or leads it away again, while the joints,
    beyond what noise explains, are not where they were shown: since when."""
    e, d, t = s.estimate, s.decision, fixed.thresholds
    been = d.arrived and not asked.other
    if d.mode.phase != SERVO or not (been or d.left < NEAR):
        d.arrived, d.astray = False, -1
        return
    if away_at_most(seen.q, asked.q, fixed) < t.elsewhere:
        d.arrived, d.astray = not asked.other, -1
        return
    off, allowed = away(seen.q, asked.q, fixed), t.elsewhere
    if not off < allowed:
        frames = max(min(v.weight[0], v.weight[1]), 1.0)
        noise = pose_deviation(v, e.p1, shaft_of(fixed)) * np.sqrt(1.0 / frames + 1.0 / SHOWN)
        allowed += CERTAIN * noise
    d.arrived = not asked.other and (been or off < allowed)
    if not off - min(d.left, NEAR) > allowed:
        d.astray = -1
    elif d.astray < 0:
        d.astray = seen.now


@compiled
def away(q: Floats, q_d: Floats, fixed: KernelParameters) -> float:
    """mm from one place of the tool, by the joints q (3,), to another, of the marker that has the
    longer way."""
    rcm = rcm_of(fixed)
    p1, p1_d = point_at(rcm, q), point_at(rcm, q_d)
    p2, p2_d = second_point(shaft_of(fixed), p1), second_point(shaft_of(fixed), p1_d)
    return max(apart(p1, p1_d), apart(p2, p2_d))


@compiled
def away_at_most(q: Floats, q_d: Floats, fixed: KernelParameters) -> float:
    """What `away` is at most, in a fraction of the time: no direction turns by more than the angles
    do."""
    zero = fixed.rcm.zero
    rho, rho_d = q[2] + zero, q_d[2] + zero
    turned = abs(q[0] - q_d[0]) + abs(q[1] - q_d[1])
    longest = max(stretch(shaft_of(fixed), (0.0, 0.0, rho)), 1.0)
    return longest * (abs(rho - rho_d) + max(abs(rho), abs(rho_d)) * turned)


@compiled
def estimate_faults(w: Watch, e: Estimate, fixed: KernelParameters) -> int:
    """What is wrong with the estimate."""
    t = fixed.thresholds
    found = 0 if e.rcm_condition <= fixed.imaged_rcm.max_condition else RCM_UNKNOWN
    J = scratch_table(3, 3)
    scale(e.J_hat, J)
    if not largest(J) <= t.largest:
        found |= ESTIMATE_LARGE
    if w.wrong >= t.disagreements:
        found |= DIVERGED
    return found


@compiled
def way_faults(d: Decision, now: int, fixed: KernelParameters) -> int:
    """What stands in the way to the target."""
    t = fixed.thresholds
    found = LIMITS[d.blocked] if d.blocked >= 0 else 0
    if d.astray >= 0 and now - d.astray > t.elsewhere_time * 1e9:
        found |= ELSEWHERE
    if not d.open >= t.closed:
        found |= SINGULAR
    elif not d.open >= t.nearly_closed:
        found |= NEARLY_SINGULAR
    patience = max(t.stall_time, t.stall_gains / fixed.controller.gain)
    if d.peak > t.stall_error and now - d.peak_time > patience * 1e9:
        found |= STALLED
    return found


@compiled
def tour_faults(w: Watch, v: Prospect, tour: Exploring, now: int, fixed: KernelParameters) -> int:
    """What is wrong while exploring."""
    if tour.no_room:
        return NO_ROOM
    if w.frozen:
        return FROZEN
    if not overdue(tour, now, fixed.exploration):
        return 0
    return SWAPPED if order(v) < CROSSED else NOT_EXPLORED
