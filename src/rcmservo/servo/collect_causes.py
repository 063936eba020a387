"""Detection of the causes that are present at a tick.

A cause is a reason why the servo does not simply move to the target, such as a lost marker. Its
detector reads the facts of the tick that are collected here.
"""

import numpy as np

from rcmservo.estimation.camera_fit import ProjectedPoint, ProjectionFit, project_markers
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    compute_pose_deviation,
    compute_spacing_covariance,
    squared_mahalanobis_distance,
    write_point_jacobian,
)
from rcmservo.geometry.kinematics import compute_point_distance
from rcmservo.geometry.tool import compute_second_marker_tuple
from rcmservo.interfaces import NEVER_NS, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_distance, compute_norm, subtract
from rcmservo.safety.causes import find_causes
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.state_machine import ACQUIRE, DISABLED, FAULT, HOLD, PAUSED, SERVO
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import (
    TickContext,
    make_rcm_struct,
    make_tool_struct,
)
from rcmservo.servo.state import forget_bound
from rcmservo.servo.target_gap import (
    TEACHING_FRAMES,
    bound_pose,
    compute_goal_distance,
    image_contradicts_joints,
    start_return,
    watch_arrival,
)

ARRIVAL_DISTANCE_MM = 1.0
"""Distance of marker 1 from the target by the image, in mm, below which the tool has arrived."""

CONTRADICTION_TIMES = 4.0
"""Time for which the image alone must contradict the joints, in `target_mismatch_time`."""

MAX_DETOUR_MM = 10.0
"""Motion (mm) away from the joints of teaching up to which errors of the model are excused.

After a longer one the tool returns by the joints. Without disturbances one run of 200 would make
one with `dlt`, one of 60 with `projection`.
"""

MISMATCH_FRACTION = 0.5
"""Fraction of `max_target_mismatch` that a prediction of the target may be wrong by."""

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
        exploration=parameters.exploration,
        thresholds=parameters.thresholds,
    )
    return find_causes(facts)


@compiled
def watch_target(tick: TickContext) -> None:
    """Record since when the image and the joints disagree on the arrival at the target.

    They disagree if the image reports the target as reached, or leads the tool away from it again,
    but the joints differ from those at teaching by more than noise explains; or if the target is
    elsewhere by the image alone. If the joints differ, or after a detour, the tool first returns by
    the joints, once for each target.
    """
    decision, setpoint, parameters = tick.stored.decision, tick.setpoint, tick.parameters
    had_arrived = decision.has_arrived and not setpoint.is_new
    remaining_mm = average_distance(tick)
    is_near = had_arrived or remaining_mm < ARRIVAL_DISTANCE_MM
    if decision.mode.phase == SERVO and decision.detour_mm > MAX_DETOUR_MM:
        start_return(tick)
    if decision.mode.phase != SERVO or not is_near or decision.returns or decision.aims_at_approach:
        decision.has_arrived, decision.mismatch_since = False, NEVER_NS
        decision.contradicted_since = NEVER_NS
        forget_bound(decision)
        return
    bound_pose(tick)
    distance_mm = compute_larger_marker_distance(tick)
    excess_mm = distance_mm - compute_allowed_distance(tick, distance_mm)
    decision.has_arrived = not setpoint.is_new and (had_arrived or excess_mm < 0.0)
    goal_excess_mm = compute_goal_distance(tick) - parameters.thresholds.max_target_mismatch
    is_elsewhere = max(excess_mm, goal_excess_mm) > min(remaining_mm, ARRIVAL_DISTANCE_MM)
    if not (is_elsewhere or contradicts_for_long(tick)) or (is_elsewhere and start_return(tick)):
        decision.mismatch_since = NEVER_NS
    elif decision.mismatch_since == NEVER_NS:
        decision.mismatch_since = tick.observation.now


@compiled
def contradicts_for_long(tick: TickContext) -> bool:
    """Return True if the image alone has contradicted the joints since long after arrival.

    By then the mean residuals no longer contain frames of the motion, which bends the tool.
    """
    decision, thresholds = tick.stored.decision, tick.parameters.thresholds
    now, is_checked = tick.observation.now, thresholds.max_target_mismatch < np.inf
    has_joints = not np.isnan(tick.setpoint.q[0])
    if not (is_checked and has_joints and image_contradicts_joints(tick)):
        decision.contradicted_since = NEVER_NS
        return False
    if decision.contradicted_since == NEVER_NS:
        decision.contradicted_since = now
    long_s = CONTRADICTION_TIMES * thresholds.target_mismatch_time
    return now - decision.contradicted_since >= long_s * 1e9


@compiled
def compute_allowed_distance(tick: TickContext, distance_mm: float) -> float:
    """Return how far (mm) from the joints of teaching the image may show the tool at the target.

    It is the threshold, and for a larger distance also what the noise of the image explains at the
    joints of teaching.
    """
    fit, parameters = tick.stored.projection_fit, tick.parameters
    allowed_mm = parameters.thresholds.max_target_mismatch
    if distance_mm < allowed_mm or np.isnan(distance_mm):
        return allowed_mm
    p1_d = tick.stored.workspace.target.p1
    frames = max(min(fit.offset_weight[0], fit.offset_weight[1]), 1.0)
    noise_mm = compute_pose_deviation(fit, p1_d, make_tool_struct(parameters))
    noise_mm *= np.sqrt(1.0 / frames + 1.0 / TEACHING_FRAMES)
    return allowed_mm + NOISE_SIGMAS * noise_mm


@compiled
def average_distance(tick: TickContext) -> float:
    """Return the length (mm) of the mean step of marker 1 to the target by the image.

    Each step has the direction of v. Noise has another direction in each frame, so that the mean
    over `target_mismatch_time` is small at the target even if single frames are a millimetre wrong.
    """
    decision, parameters = tick.stored.decision, tick.parameters
    begins = tick.setpoint.is_new or decision.mode.phase != SERVO
    weight = min(parameters.period * 1e-9 / parameters.thresholds.target_mismatch_time, 1.0)
    speed = compute_norm(decision.v)
    for i in range(3):
        step_mm = decision.remaining_mm * decision.v[i] / speed if speed > 0.0 else 0.0
        mean_mm = step_mm if begins else decision.mean_step[i]
        decision.mean_step[i] = mean_mm + weight * (step_mm - mean_mm)
    return compute_norm(decision.mean_step)


@compiled
def compute_larger_marker_distance(tick: TickContext) -> float:
    """Return the larger of both markers' distances (mm) from their positions of teaching.

    Both are by the joints. It is NaN without joints of teaching.
    """
    shaft, workspace = make_tool_struct(tick.parameters), tick.stored.workspace
    p1, p1_d = workspace.present_p1, workspace.target.p1
    p2, p2_d = compute_second_marker_tuple(shaft, p1), compute_second_marker_tuple(shaft, p1_d)
    return max(compute_distance(p1, p1_d), compute_point_distance(p2, p2_d))


@compiled
def compare_target_with_fit(tick: TickContext) -> None:
    """Record whether the fit contradicts the taught markers at the joints of teaching.

    A marker may be as far from its prediction as noise and the covariance of the fit explain, a
    fraction of the motion to the target, and half of what `watch_target` allows on arrival. For the
    vector between the markers that fraction is one of its length, because a lens, an arm or a tool
    that the fit does not know displaces both markers nearly alike. After a detour away
    from the joints of teaching, only noise and covariance count. Without these joints nothing
    contradicts the markers.
    """
    stored, setpoint, decision = tick.stored, tick.setpoint, tick.stored.decision
    thresholds = tick.parameters.thresholds
    has_joints, is_checked = not np.isnan(setpoint.q[0]), thresholds.max_target_mismatch < np.inf
    decision.is_implausible = False
    decision.is_unchecked = is_checked and not has_joints
    if not (is_checked and has_joints):
        return
    update_detour(tick)
    if not stored.exploration_state.fit_is_known:
        return
    error, predicted = np.empty((2, 2)), stored.workspace.target.markers
    for k in range(2):
        for i in range(2):
            error[k, i] = setpoint.points[k, i] - predicted[k, i]
    # with half of it for each marker, the vector between them differs by less too
    is_small = max(compute_norm(error[0]), compute_norm(error[1])) <= 0.5 * thresholds.model_error
    is_explained = is_small or explains_errors(tick, error, decision.detour_mm <= MAX_DETOUR_MM)
    decision.is_implausible = not is_explained or watch_arrival(tick)


@compiled
def explains_errors(tick: TickContext, error: Floats, is_excused: bool) -> bool:
    """Return True if noise, covariance and errors of the model explain the errors of a target.

    `error` (2, 2) px is the difference of the taught markers from the prediction of the fit. Errors
    of the model count if `is_excused`.
    """
    stored, setpoint, thresholds = tick.stored, tick.setpoint, tick.parameters.thresholds
    fit, target, is_explained = stored.projection_fit, stored.workspace.target, True
    predicted = project_markers(fit, target.p1, make_tool_struct(tick.parameters))
    largest_scale = 0.0
    for k in range(2):
        motion_px = compute_distance(target.markers[k], stored.estimate.points[k])
        scale = compute_image_scale(fit, predicted[k])
        model_px = compute_model_error(motion_px, scale, thresholds) if is_excused else 0.0
        excess_px = compute_norm(error[k]) - thresholds.model_error - model_px
        if excess_px > 0.0:
            covariance = compute_image_covariance(fit, predicted[k])
            is_explained &= noise_explains(tick, error[k], excess_px, covariance)
        largest_scale = max(largest_scale, scale)
    error_of_vector = subtract(error[1], error[0])
    length_px = compute_distance(setpoint.points[1], setpoint.points[0])
    model_px = compute_model_error(length_px, largest_scale, thresholds) if is_excused else 0.0
    excess_px = compute_norm(error_of_vector) - thresholds.model_error - model_px
    if excess_px > 0.0:
        covariance = compute_spacing_covariance(fit, predicted[0], predicted[1])
        is_explained &= noise_explains(tick, error_of_vector, excess_px, covariance)
    return is_explained


@compiled
def compute_image_scale(fit: ProjectionFit, prediction: ProjectedPoint) -> float:
    """Return the largest motion in px of a predicted image per mm of its point."""
    px_per_mm = np.empty((2, 3))
    write_point_jacobian(fit, prediction, px_per_mm)
    return max(compute_norm(px_per_mm[0]), compute_norm(px_per_mm[1]))


@compiled
def compute_model_error(length_px: float, px_per_mm: float, thresholds: Thresholds) -> float:
    """Return by how much (px) a model of ideal lens, arm and tool may be wrong about a target.

    It grows with a length (px): of the motion to the target, or of the tool.
    """
    mismatch_mm = MISMATCH_FRACTION * thresholds.max_target_mismatch
    return mismatch_mm * px_per_mm + thresholds.target_error_fraction * length_px


@compiled
def update_detour(tick: TickContext) -> None:
    """Store how far (mm) the tool has moved away from the joints of teaching.

    It counts from the nearest point since the motion to the target began.
    """
    decision, setpoint = tick.stored.decision, tick.setpoint
    distance_mm = compute_larger_marker_distance(tick)
    is_moving = decision.mode.phase in (ACQUIRE, SERVO, HOLD) and not setpoint.is_new
    decision.nearest_mm = min(decision.nearest_mm, distance_mm) if is_moving else distance_mm
    decision.detour_mm = distance_mm - decision.nearest_mm


@compiled
def noise_explains(
    tick: TickContext, error: Floats, excess_px: float, covariance: tuple[float, float, float]
) -> bool:
    """Return whether noise and the covariance of the fit explain the excess of a difference."""
    fit, thresholds = tick.stored.projection_fit, tick.parameters.thresholds
    squared = squared_mahalanobis_distance(error[0], error[1], covariance, fit.noise_variance)
    share = excess_px / compute_norm(error)
    return share**2 * squared <= thresholds.max_target_deviation**2
