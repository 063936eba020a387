"""Gap between the position of the target by the image and by the joints of teaching.

Let h (4,) px be the taught markers by the projection fit at the joints of teaching, H = ∂m/∂p₁
(4, 3) px/mm there, and r (4,) px the residuals of the markers, which are taken to be the same
there. By the image the target m_d (4,) px is off these joints by

    gap = (HᵀH + λ I)⁻¹ Hᵀ (m_d − h − r)    mm

The servo aims at h + r + H gap instead of m_d. With λ = (s f w)² the joints of teaching count as a
measurement of the target with the standard deviation 1/w (mm), the trust w in them being a setting.
The image counts with errors of s (mm), the rms of the residuals on the way, but at least 0.1 mm. f
is the largest px per mm. Where the image is sharp, it decides; in a direction that it hardly shows,
the joints do. The present markers are replaced alike, with h and H at the present joints.

The gap is also a prediction of where the tool will stop. A camera that moves or a marker that
slides changes the residuals, so that the gap grows while the tool still moves. At the target the
gap by the image alone (λ = 0) shows whether the image contradicts the joints.
"""

import numpy as np

from rcmservo.estimation.camera_fit import project_markers
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    compute_markers_jacobian,
    predict_markers,
    write_damped_pseudoinverse,
    write_markers_jacobian,
    write_predicted_markers,
)
from rcmservo.geometry.kinematics import Point, compute_position_tuple
from rcmservo.geometry.tool import compute_second_marker_jacobian
from rcmservo.interfaces import NEVER_NS, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import (
    bilinear_form,
    compute_distance,
    compute_norm,
    copy_into,
    dot,
    fill,
    multiply_matrices,
    multiply_vector,
    subtract,
)
from rcmservo.numerics.small_solvers import invert
from rcmservo.safety.checks.drift import compute_arm_error
from rcmservo.servo.kernel_parameters import TickContext, make_rcm_struct, make_tool_struct
from rcmservo.servo.state import forget_bound, restart_stall_rule

GAP_MM = 2.3
"""Gap (mm) that is allowed at the target, in addition to noise."""

MAX_WAY_MM = 15.0
"""Distance (mm) from the target beyond which errors of the model may be larger than that."""

GAP_PER_WAY = 0.1
"""Allowed gap per distance that is left to the target."""

GAP_SIGMA_RATIO = 0.5
"""Standard deviations of the gap that are allowed, as a ratio of `max_target_deviation`."""

MAX_ARM_ERROR_MM = 0.19
"""Largest rms residual (mm) that is taken for errors of arm and tool in the predicted gap."""

ARRIVAL_SIGMA_RATIO = 0.63
"""Standard deviations of the gap that are allowed at the target, as a ratio of
`max_target_deviation`."""

ARRIVAL_ERROR_RATIO = 0.5
"""Standard deviation of the errors of arm and tool at the target, as a ratio of the rms residual on
the way."""

RETURN_DEVIATION_MM = 0.3
"""Standard deviation (mm) with which an arm returns to the same joints."""

BOUND_FACTOR = 1.2
"""Bound of the pose with a probability of 95 %, in standard deviations of its three coordinates
together. It covers 93 to 96 % of simulated runs with ideal, good and worn arms."""

BOUND_TEACHING_FRAMES = 300.0
"""Number of frames in a target by default, whose noise the bound contains."""

JOINT_ERROR_RATIO = 2.0
"""Standard deviation of the joints at the target, as a ratio of the rms residual on the way."""

NEAR_MM = 5.0
"""Distance (mm) from the taught position at which the approach ends."""

MIN_IMAGE_ERROR_MM = 0.1
"""Smallest error s (mm) of the image.

With a smaller one the joints would not hold the tool at the target if the image freezes: its error
of a fraction of a px would lead the tool away in a direction that the image hardly shows.
"""

MAX_APPROACH_RATIO = 0.2
"""Distance from the pose next to the target at which it is reached, as a ratio of its distance from
the target."""

MIN_SAMPLE_MM = 0.3
"""Motion of marker 1 (mm) between two samples of the residuals."""

TEACHING_FRAMES = 30.0
"""Number of frames that are assumed to be averaged in a target."""


@compiled
def predict_target(tick: TickContext) -> None:
    """Write the prediction of the target by the newest fit, from which the gap follows."""
    stored, q_d = tick.stored, tick.setpoint.q
    fit, target = stored.projection_fit, stored.workspace.target
    rcm, shaft = make_rcm_struct(tick.parameters), make_tool_struct(tick.parameters)
    p1_d = compute_position_tuple(rcm, q_d)
    target.p1[0], target.p1[1], target.p1[2] = p1_d
    p1 = compute_position_tuple(rcm, tick.observation.q) if np.isnan(q_d[0]) else p1_d
    write_markers_jacobian(fit, p1, shaft, target.H)
    write_predicted_markers(fit, p1, shaft, target.markers)
    damping = select_damping(tick, compute_arm_error(stored.monitor))
    target.is_determined = write_damped_pseudoinverse(target.H, damping, target.P)


@compiled
def aim_at_target(tick: TickContext) -> None:
    """Write the markers (2, 2) raw px that the servo aims at, and marker 1 (3,) mm there.

    Before the end of the exploration, without joints of teaching, or if the controller trusts the
    image alone, `decision.aim` are the taught markers and `decision.goal` is NaN.
    """
    stored, setpoint, target = tick.stored, tick.setpoint, tick.stored.workspace.target
    decision, controller = stored.decision, tick.parameters.controller
    aim, goal = decision.aim, decision.goal
    copy_into(aim, setpoint.points)
    fill(goal, np.nan)
    decision.aims_at_approach = False
    has_joints = not np.isnan(setpoint.q[0])
    if not (has_joints and stored.exploration_state.is_done and target.is_determined):
        return
    if controller.joint_trust > 0.0:
        move_to_gap(target.markers, target.H, target.P, stored.projection_fit.offset, aim, goal)
        for j in range(3):
            goal[j] += target.p1[j]
    if not decision.has_approached:
        aim_at_approach(tick)


@compiled
def aim_at_approach(tick: TickContext) -> None:
    """Shift the aim to the pose from which the target is approached, if there is one."""
    decision, H = tick.stored.decision, tick.stored.workspace.target.H
    shift = compute_approach(tick)
    decision.aims_at_approach = shift[0] != 0.0 or shift[1] != 0.0 or shift[2] != 0.0
    for k in range(4):
        for j in range(3):
            decision.aim[k // 2, k % 2] += H[k, j] * shift[j]


@compiled
def compute_approach(tick: TickContext) -> Point:
    """Return marker 1 (mm) at the pose from which the target is approached, from the target."""
    q_d, offset = tick.setpoint.q, tick.parameters.controller.approach
    q = q_d[0] + offset[0], q_d[1] + offset[1], q_d[2] + offset[2]
    p1 = compute_position_tuple(make_rcm_struct(tick.parameters), q)
    p1_d = tick.stored.workspace.target.p1
    return p1[0] - p1_d[0], p1[1] - p1_d[1], p1[2] - p1_d[2]


@compiled
def end_approach(tick: TickContext) -> None:
    """Let the tool go on to the target once it has reached the pose next to it."""
    decision, shift = tick.stored.decision, compute_approach(tick)
    length_mm = np.sqrt(shift[0] ** 2 + shift[1] ** 2 + shift[2] ** 2)
    if decision.remaining_mm < MAX_APPROACH_RATIO * length_mm:
        decision.aims_at_approach, decision.has_approached = False, True
        restart_stall_rule(decision, tick.observation.now)


@compiled
def move_to_gap(
    predicted: Floats, H: Floats, P: Floats, residuals: Floats, points: Floats, gap: Floats
) -> None:
    """Replace markers (2, 2) raw px by h + r + H gap, and write the gap (3,) mm.

    h are the predicted markers (2, 2) raw px, r the residuals (2, 2) px.
    """
    write_gap(P, points, predicted, residuals, gap)
    for k in range(4):
        moved = predicted[k // 2, k % 2] + residuals[k // 2, k % 2]
        for j in range(3):
            moved += H[k, j] * gap[j]
        points[k // 2, k % 2] = moved


@compiled
def filter_weak_directions(tick: TickContext, points: Floats) -> None:
    """Filter the markers (2, 2) raw px of a frame in directions that the image hardly shows.

    Their difference from the fit at the present joints is weighed as that of the taught markers is
    at the joints of teaching. Otherwise slow motions of the air, for example, would move the tool
    by more than a millimetre. Markers that the fit has predicted do not change.
    """
    stored, shaft = tick.stored, make_tool_struct(tick.parameters)
    if np.isnan(stored.decision.goal[0]):
        return
    fit, p1, P, gap = stored.projection_fit, stored.estimate.p1, np.empty((3, 4)), np.empty(3)
    H = compute_markers_jacobian(fit, p1, shaft)
    if write_damped_pseudoinverse(H, select_damping(tick, compute_arm_error(stored.monitor)), P):
        move_to_gap(predict_markers(fit, p1, shaft), H, P, fit.offset, points, gap)


@compiled
def start_return(tick: TickContext) -> bool:
    """Let the tool return to the goal by the joints, once for a target; return True if it does.

    The caller has found that the image leads to another pose that looks the same, or on a detour.
    """
    decision, max_mm = tick.stored.decision, tick.parameters.thresholds.max_target_mismatch
    if compute_goal_distance(tick) > max_mm and not decision.has_returned:
        decision.returns = decision.has_returned = True
    return decision.returns


@compiled
def compute_goal_distance(tick: TickContext) -> float:
    """Return the distance (mm) of marker 1 from the goal by the joints, 0 if it is unknown."""
    goal = tick.stored.decision.goal
    if np.isnan(goal[0]):
        return 0.0
    return compute_distance(tick.stored.workspace.present_p1, goal)


@compiled
def select_damping(tick: TickContext, arm_error_mm: float) -> float:
    """Return s w, the damping of the gap that the servo aims with; 0 without joints of teaching."""
    trust = tick.parameters.controller.joint_trust
    image_error_mm = max(arm_error_mm, MIN_IMAGE_ERROR_MM)
    return 0.0 if np.isnan(tick.setpoint.q[0]) else image_error_mm * trust


@compiled
def write_gap(P: Floats, taught: Floats, predicted: Floats, residuals: Floats, gap: Floats) -> None:
    """Write the gap P (m_d − h − r) (3,) mm, with P (3, 4) mm/px and markers (2, 2) raw px."""
    for i in range(3):
        gap[i] = 0.0
        for k in range(4):
            u, v = k // 2, k % 2
            gap[i] += P[i, k] * (taught[u, v] - (predicted[u, v] + residuals[u, v]))


@compiled
def watch_arrival(tick: TickContext) -> bool:
    """Return True if the tool will stop too far from the joints of teaching, for long enough."""
    decision, monitor, thresholds = (
        tick.stored.decision,
        tick.stored.monitor,
        tick.parameters.thresholds,
    )
    now, has_mean = tick.observation.now, monitor.averaged_frames >= thresholds.drift_frames
    if not (tick.stored.exploration_state.is_done and has_mean):
        decision.gap_since = NEVER_NS
        return False
    sample_residuals(tick)
    if not arrives_elsewhere(tick):
        decision.gap_since = NEVER_NS
        return False
    if decision.gap_since == NEVER_NS:
        decision.gap_since = now
    return now - decision.gap_since >= thresholds.target_mismatch_time * 1e9


@compiled
def sample_residuals(tick: TickContext) -> None:
    """Add the mean residuals in mm to their sum of squares, once for each 0.3 mm of the approach.

    Near the target trouble with the picture would count as an error of the arm.
    """
    stored, monitor, p1 = tick.stored, tick.stored.monitor, tick.stored.estimate.p1
    is_near = compute_distance(p1, stored.workspace.target.p1) < NEAR_MM
    if is_near or compute_distance(p1, monitor.sampled_p1) < MIN_SAMPLE_MM:
        return
    H = compute_markers_jacobian(stored.projection_fit, p1, make_tool_struct(tick.parameters))
    px_per_mm = max(compute_norm(H[0]), compute_norm(H[1]), 1e-6)
    squared_px = 0.5 * compute_norm(monitor.mean_residual) ** 2
    monitor.residual_sums[0] += squared_px / px_per_mm**2
    monitor.residual_sums[1] += 1.0
    copy_into(monitor.sampled_p1, p1)


@compiled
def arrives_elsewhere(tick: TickContext) -> bool:
    """Return True if the predicted gap exceeds what is allowed."""
    stored, thresholds, target = (
        tick.stored,
        tick.parameters.thresholds,
        tick.stored.workspace.target,
    )
    way_mm = compute_distance(stored.workspace.present_p1, target.p1)
    if not way_mm <= MAX_WAY_MM:
        return False
    P, gap = np.empty((3, 4)), np.empty(3)
    damping = min(compute_arm_error(stored.monitor), MAX_ARM_ERROR_MM)
    if not write_damped_pseudoinverse(target.H, damping, P):
        return False
    mean_residual = stored.monitor.mean_residual
    write_gap(P, tick.setpoint.points, target.markers, mean_residual, gap)
    excess_mm = compute_norm(gap) - GAP_MM - GAP_PER_WAY * way_mm
    if not excess_mm > 0.0:
        return False
    C = compute_gap_covariance(tick, P, 0.0)
    sigmas = GAP_SIGMA_RATIO * thresholds.max_target_deviation
    return excess_mm > sigmas * np.sqrt(C[0, 0] + C[1, 1] + C[2, 2])


@compiled
def compute_gap_covariance(tick: TickContext, P: Floats, arm_error_mm: float) -> Floats:
    """Return the covariance (3, 3) mm² of the gap, P R Pᵀ.

    R (4, 4) px² contains the noise of the mean residuals and of the taught markers, the covariance
    of the fit, and errors of arm and tool with the standard deviation `arm_error_mm`.
    """
    fit, target = tick.stored.projection_fit, tick.stored.workspace.target
    H, R, frames = target.H, np.zeros((4, 4)), tick.parameters.thresholds.drift_frames
    predicted = project_markers(fit, target.p1, make_tool_struct(tick.parameters))
    noise = fit.noise_variance * (1.0 / frames + 1.0 / TEACHING_FRAMES)
    for k in range(2):
        u, v = 2 * k, 2 * k + 1
        uu, uv, vv = compute_image_covariance(fit, predicted[k])
        R[u, u], R[u, v], R[v, u], R[v, v] = uu + noise, uv, uv, vv + noise
        for i in range(2):
            for j in range(2):
                R[u + i, u + j] += arm_error_mm**2 * dot(H[u + i], H[u + j])
    return multiply_matrices(multiply_matrices(P, R), P.T)


@compiled
def image_contradicts_joints(tick: TickContext) -> bool:
    """Return True if the gap by the image alone exceeds noise and errors of arm and tool.

    The tool is at the target, so that its residuals are those at the target.
    """
    monitor, thresholds = tick.stored.monitor, tick.parameters.thresholds
    target, P, gap = tick.stored.workspace.target, np.empty((3, 4)), np.empty(3)
    has_mean = monitor.averaged_frames >= thresholds.drift_frames
    if not (has_mean and write_damped_pseudoinverse(target.H, 0.0, P)):
        return False
    write_gap(P, tick.setpoint.points, target.markers, monitor.mean_residual, gap)
    max_sigma = ARRIVAL_SIGMA_RATIO * thresholds.max_target_deviation
    if not compute_norm(gap) > max_sigma * RETURN_DEVIATION_MM:
        return False
    C = compute_gap_covariance(tick, P, ARRIVAL_ERROR_RATIO * compute_arm_error(monitor))
    for i in range(3):
        C[i, i] += RETURN_DEVIATION_MM**2
    return invert(C) and bilinear_form(C, gap, gap) > max_sigma**2


@compiled
def bound_pose(tick: TickContext) -> None:
    """Store the distance (mm) of marker 2 from its taught position with 95 %, and its parts.

    Noise σ (px) and errors e (mm) of arm and tool move marker 1 by P times their pixels, and the
    joints, which decide in the directions of I − P H, have the error 2 e. With ∂p₂/∂p₁ = T and
    Mₖ = T Pₖ Hₖ for marker k the error of marker 2 has the squared expectation

        σ² |T P|² + e² (|M₁|² + |M₂|² + 4 |T − M₁ − M₂|²)

    e is the rms of the residuals on the way without half of their noise, of which the fit has
    absorbed a part. The way of marker 2 that is left to the goal is added.
    """
    stored, target = tick.stored, tick.stored.workspace.target
    fit, H = stored.projection_fit, target.H
    decision, parts = stored.decision, stored.decision.bound_parts
    if not target.is_determined:
        forget_bound(decision)
        decision.pose_bound = np.inf
        return
    p1 = stored.workspace.present_p1 if np.isnan(target.p1[0]) else target.p1
    T = compute_second_marker_jacobian(make_tool_struct(tick.parameters), p1)
    TP, px_per_mm = multiply_matrices(T, target.P), max(compute_norm(H[0]), compute_norm(H[1]))
    residual_noise = fit.noise_variance / (tick.parameters.thresholds.drift_frames * px_per_mm**2)
    squared_mm = max(compute_arm_error(stored.monitor) ** 2 - residual_noise, 0.0)
    frames = max(min(fit.offset_weight[0], fit.offset_weight[1]), 1.0)
    noise = fit.noise_variance * (1.0 / frames + 1.0 / BOUND_TEACHING_FRAMES)
    variance = 0.0
    for i in range(3):
        for j in range(3):
            M_1 = TP[i, 0] * H[0, j] + TP[i, 1] * H[1, j]
            M_2 = TP[i, 2] * H[2, j] + TP[i, 3] * H[3, j]
            by_joints = JOINT_ERROR_RATIO * (T[i, j] - M_1 - M_2)
            variance += squared_mm * (M_1**2 + M_2**2 + by_joints**2)
    parts[0] = BOUND_FACTOR * np.sqrt(noise) * compute_norm(TP)
    parts[1] = BOUND_FACTOR * np.sqrt(variance)
    parts[2] = compute_way_left(tick, T)
    decision.pose_bound = np.sqrt(parts[0] ** 2 + parts[1] ** 2) + parts[2]


@compiled
def compute_way_left(tick: TickContext, T: Floats) -> float:
    """Return the distance (mm) of marker 2 from the goal, with ∂p₂/∂p₁ = T; 0 if it is unknown."""
    goal, p1 = tick.stored.decision.goal, tick.stored.workspace.present_p1
    return 0.0 if np.isnan(goal[0]) else compute_norm(multiply_vector(T, subtract(p1, goal)))
