"""Detection of the causes that are present at a tick."""

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

ARRIVAL_DISTANCE_MM = 1.0
"""Distance of marker 1 from the target by the image, in mm, below which the tool has arrived."""

ASSUMED_TEACHING_FRAMES = 30.0
"""Number of frames assumed to be averaged in a target."""

NOISE_SIGMAS = 3.0
"""Standard deviations of pose noise that a distance may contain."""


@compiled
def collect_causes(tick: TickContext) -> int:
    """Return the set of causes that are present, as bits."""
    stored, parameters = tick.stored, tick.parameters
    if stored.tour.done:
        watch_target(tick)
    facts = TickFacts(
        seen=stored.watch.observation,
        watch=stored.watch,
        estimate=stored.estimate,
        tour=stored.tour,
        progress=stored.decision,
        prospect=stored.projection_fit,
        drive_requested=stored.decision.mode.phase not in (DISABLED, FAULT),
        paused=stored.decision.mode.phase == PAUSED,
        taught=tick.setpoint.shown,
        estimator_failed=stored.estimated.failed,
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
    """Record since when the image and the joints disagree on the arrival at the target.

    They disagree if the image reports the target as reached, or leads the tool away from it again,
    but the joints differ from those at teaching by more than noise explains.
    """
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    decision, fit, allowed = stored.decision, stored.projection_fit, parameters.thresholds.elsewhere
    q, q_d, shaft = tick.observation.q, setpoint.q, shaft_of(parameters)
    was_there = decision.arrived and not setpoint.is_new
    if decision.mode.phase != SERVO or not (was_there or decision.left < ARRIVAL_DISTANCE_MM):
        decision.arrived, decision.astray = False, -1
        return
    if bound_marker_distance(q, q_d, parameters) < allowed:
        decision.arrived, decision.astray = not setpoint.is_new, -1
        return
    distance = larger_marker_distance(q, q_d, parameters)
    if not distance < allowed:
        frames = max(min(fit.weight[0], fit.weight[1]), 1.0)
        noise = pose_deviation(fit, stored.estimate.p1, shaft)
        noise *= np.sqrt(1.0 / frames + 1.0 / ASSUMED_TEACHING_FRAMES)
        allowed += NOISE_SIGMAS * noise
    decision.arrived = not setpoint.is_new and (was_there or distance < allowed)
    if not distance - min(decision.left, ARRIVAL_DISTANCE_MM) > allowed:
        decision.astray = -1
    elif decision.astray < 0:
        decision.astray = tick.observation.now


@compiled
def larger_marker_distance(q: Floats, q_d: Floats, parameters: KernelParameters) -> float:
    """Return the larger of the distances (mm) of both markers between the joints q and q_d (3,)."""
    rcm, shaft = rcm_of(parameters), shaft_of(parameters)
    p1, p1_d = point_at(rcm, q), point_at(rcm, q_d)
    p2, p2_d = second_point(shaft, p1), second_point(shaft, p1_d)
    return max(apart(p1, p1_d), apart(p2, p2_d))


@compiled
def bound_marker_distance(q: Floats, q_d: Floats, parameters: KernelParameters) -> float:
    """Return an upper bound (mm) of `larger_marker_distance`, in a fraction of its time.

    The direction of the tool turns by no more than the sum of the changes of the angles.
    """
    zero = parameters.rcm.zero
    rho, rho_d = q[2] + zero, q_d[2] + zero
    turned = abs(q[0] - q_d[0]) + abs(q[1] - q_d[1])
    longest = max(stretch(shaft_of(parameters), (0.0, 0.0, rho)), 1.0)
    return longest * (abs(rho - rho_d) + max(abs(rho), abs(rho_d)) * turned)
