"""Causes that are present at a tick, as a set."""

import numpy as np

from rcmservo.estimation.projection_prediction import pose_deviation
from rcmservo.geometry.kinematics import apart, point_at
from rcmservo.geometry.tool import second_point, stretch
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.safety.causes import find_causes
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.state_machine import DISABLED, FAULT, PAUSED, SERVO
from rcmservo.servo.kernel_parameters import KernelParameters, TickContext, rcm_of, shaft_of

NEAR = 1.0
"""mm from the target, by the picture, up to which the tool counts as being there."""

SHOWN = 30.0
"""Frames that a target is taken to be the mean of."""

CERTAIN = 3.0
"""Standard deviations."""


@compiled
def collect_causes(tick: TickContext) -> int:
    """Return the set of the causes that are present."""
    s, parameters = tick.stored, tick.parameters
    if s.tour.done:
        watch_target(tick)
    facts = TickFacts(
        seen=s.watch.observation,
        watch=s.watch,
        estimate=s.estimate,
        tour=s.tour,
        progress=s.decision,
        prospect=s.prospect,
        drive_requested=s.decision.mode.phase not in (DISABLED, FAULT),
        paused=s.decision.mode.phase == PAUSED,
        taught=tick.setpoint.shown,
        estimator_failed=s.estimated.failed,
        rcm=rcm_of(parameters),
        period=parameters.period,
        gain=parameters.controller.gain,
        max_rcm_condition=parameters.imaged_rcm.max_condition,
        exploration=parameters.exploration,
        thresholds=parameters.thresholds,
    )
    return find_causes(facts)


@compiled
def watch_target(tick: TickContext) -> None:
    """Record since when the image reports the target as reached, or leads the tool away from it
    again, but the joints, beyond what noise explains, are not where they were taught.
    """
    s, setpoint, parameters, now = tick.stored, tick.setpoint, tick.parameters, tick.observation.now
    e, d, fit, allowed = s.estimate, s.decision, s.prospect, parameters.thresholds.elsewhere
    q, q_d, shaft = tick.observation.q, setpoint.q, shaft_of(parameters)
    been = d.arrived and not setpoint.is_new
    if d.mode.phase != SERVO or not (been or d.left < NEAR):
        d.arrived, d.astray = False, -1
        return
    if away_at_most(q, q_d, parameters) < allowed:
        d.arrived, d.astray = not setpoint.is_new, -1
        return
    off = away(q, q_d, parameters)
    if not off < allowed:
        frames = max(min(fit.weight[0], fit.weight[1]), 1.0)
        noise = pose_deviation(fit, e.p1, shaft) * np.sqrt(1.0 / frames + 1.0 / SHOWN)
        allowed += CERTAIN * noise
    d.arrived = not setpoint.is_new and (been or off < allowed)
    if not off - min(d.left, NEAR) > allowed:
        d.astray = -1
    elif d.astray < 0:
        d.astray = now


@compiled
def away(q: Floats, q_d: Floats, fixed: KernelParameters) -> float:
    """Mm from one place of the tool, by the joints q (3,), to another, of the marker that has the
    longer way.
    """
    rcm = rcm_of(fixed)
    p1, p1_d = point_at(rcm, q), point_at(rcm, q_d)
    p2, p2_d = second_point(shaft_of(fixed), p1), second_point(shaft_of(fixed), p1_d)
    return max(apart(p1, p1_d), apart(p2, p2_d))


@compiled
def away_at_most(q: Floats, q_d: Floats, fixed: KernelParameters) -> float:
    """What `away` is at most, in a fraction of the time: no direction turns by more than the angles
    do.
    """
    zero = fixed.rcm.zero
    rho, rho_d = q[2] + zero, q_d[2] + zero
    turned = abs(q[0] - q_d[0]) + abs(q[1] - q_d[1])
    longest = max(stretch(shaft_of(fixed), (0.0, 0.0, rho)), 1.0)
    return longest * (abs(rho - rho_d) + max(abs(rho), abs(rho_d)) * turned)
