"""The law where there is an estimate, and all that is wrong at a tick, as a set of causes."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.guard.causes import find_causes
from rcmservo.guard.checks.facts import TickFacts
from rcmservo.guard.states import DISABLED, FAULT, PAUSED, SERVO
from rcmservo.interfaces import Floats, ObservationStruct
from rcmservo.memory import scratch, scratch_table
from rcmservo.method.controller import MOST, Heading, control, scale
from rcmservo.method.estimators.estimate import Estimate
from rcmservo.method.features import SCALE, wrapped
from rcmservo.method.foresight import pose_deviation
from rcmservo.method.kinematics import Point, apart, blocked, point_at
from rcmservo.method.prospect import Prospect
from rcmservo.method.tool import fastest_point, second_point, stretch
from rcmservo.servo.kernel_parameters import Asked, KernelParameters, rcm_of, shaft_of
from rcmservo.servo.state import Decision, Kept

NEAR = 1.0
"""mm from the target, by the picture, up to which the tool counts as being there."""

SHOWN = 30.0
"""Frames that a target is taken to be the mean of."""

CERTAIN = 3.0
"""Standard deviations."""


@compiled
def decide(
    s: Kept,
    seen: ObservationStruct,
    asked: Asked,
    estimator_failed: bool,
    fixed: KernelParameters,
) -> int:
    """Head for the target by the law, where there is an estimate; return the set of the causes
    that are present."""
    d = s.decision
    if s.tour.done:
        steer(s.estimate, d, seen, d.mode.phase == SERVO, fixed)
        stray(s, s.prospect, seen, asked, fixed)
    facts = TickFacts(
        seen,
        s.watch,
        s.estimate,
        s.tour,
        d,
        s.prospect,
        d.mode.phase not in (DISABLED, FAULT),
        d.mode.phase == PAUSED,
        asked.shown,
        estimator_failed,
        rcm_of(fixed),
        fixed.period,
        fixed.controller.gain,
        fixed.imaged_rcm.max_condition,
        fixed.exploration,
        fixed.thresholds,
    )
    return find_causes(facts)


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
