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

from rcmservo.estimation.camera_fit import ProjectionFit, project_markers
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    compute_markers_jacobian,
    write_damped_pseudoinverse,
)
from rcmservo.geometry.kinematics import Point, compute_point_distance, compute_position_tuple
from rcmservo.geometry.tool import ToolStruct, compute_second_marker_jacobian
from rcmservo.interfaces import NEVER_NS, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import (
    bilinear_form,
    compute_norm,
    copy_into,
    dot,
    fill,
    multiply_matrices,
)
from rcmservo.numerics.small_solvers import invert
from rcmservo.safety.checks.drift import compute_arm_error
from rcmservo.servo.kernel_parameters import TickContext, make_rcm_struct, make_tool_struct

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

MIN_SAMPLE_MM = 0.3
"""Motion of marker 1 (mm) between two samples of the residuals."""

TEACHING_FRAMES = 30.0
"""Number of frames that are assumed to be averaged in a target."""


@compiled
def aim_at_target(tick: TickContext) -> None:
    """Write the markers (2, 2) raw px that the servo aims at, and marker 1 (3,) mm there.

    Before the end of the exploration, without joints of teaching, or if the controller trusts the
    image alone, `decision.aim` are the taught markers and `decision.goal` is NaN.
    """
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    aim, goal = stored.decision.aim, stored.decision.goal
    copy_into(aim, setpoint.points)
    fill(goal, np.nan)
    helps = parameters.controller.joint_trust > 0.0 and not np.isnan(setpoint.q[0])
    if not (helps and stored.exploration_state.is_done):
        return
    p1_d, gap = compute_position_tuple(make_rcm_struct(parameters), setpoint.q), np.zeros(3)
    if move_to_gap(tick, p1_d, aim, gap):
        for j in range(3):
            goal[j] = p1_d[j] + gap[j]


@compiled
def move_to_gap(tick: TickContext, p1: Point, points: Floats, gap: Floats) -> bool:
    """Replace markers (2, 2) raw px by h + r + H gap, with h, H and the gap (3,) mm at p1 mm.

    Return False, with the markers as they are, if the image does not determine the gap.
    """
    fit, shaft = tick.stored.projection_fit, make_tool_struct(tick.parameters)
    H, P = compute_markers_jacobian(fit, p1, shaft), np.empty((3, 4))
    damping = select_damping(tick, compute_arm_error(tick.stored.monitor))
    if not write_damped_pseudoinverse(H, damping, P):
        return False
    expected = expect_taught_markers(fit, p1, shaft, fit.offset)
    copy_into(gap, compute_gap(P, points, expected))
    for k in range(4):
        points[k // 2, k % 2] = expected[k]
        for j in range(3):
            points[k // 2, k % 2] += H[k, j] * gap[j]
    return True


@compiled
def filter_weak_directions(tick: TickContext, points: Floats) -> None:
    """Filter the markers (2, 2) raw px of a frame in directions that the image hardly shows.

    Their difference from the fit at the present joints is weighed as that of the taught markers is
    at the joints of teaching. Otherwise slow motions of the air, for example, would move the tool
    by more than a millimetre. Markers that the fit has predicted do not change.
    """
    if not np.isnan(tick.stored.decision.goal[0]):
        p1 = tick.stored.estimate.p1
        move_to_gap(tick, (p1[0], p1[1], p1[2]), points, np.zeros(3))


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
    p1 = compute_position_tuple(make_rcm_struct(tick.parameters), tick.observation.q)
    return compute_point_distance(p1, (goal[0], goal[1], goal[2]))


@compiled
def select_damping(tick: TickContext, arm_error_mm: float) -> float:
    """Return s w, the damping of the gap that the servo aims with; 0 without joints of teaching."""
    trust = tick.parameters.controller.joint_trust
    image_error_mm = max(arm_error_mm, MIN_IMAGE_ERROR_MM)
    return 0.0 if np.isnan(tick.setpoint.q[0]) else image_error_mm * trust


@compiled
def expect_taught_markers(
    fit: ProjectionFit, p1_d: Point, shaft: ToolStruct, residuals: Floats
) -> Floats:
    """Return h + r (4,) raw px with marker 1 at p1_d mm, for the residuals r (2, 2) px."""
    predicted, expected = project_markers(fit, p1_d, shaft), np.empty(4)
    for k in range(2):
        for i in range(2):
            expected[2 * k + i] = fit.origin[3 + i] + predicted[k].m[i] + residuals[k, i]
    return expected


@compiled
def compute_gap(P: Floats, taught: Floats, expected: Floats) -> Floats:
    """Return the gap (3,) mm between the taught (2, 2) and the expected (4,) markers in raw px.

    P (3, 4) mm/px is (HᵀH + λ I)⁻¹ Hᵀ.
    """
    gap = np.zeros(3)
    for i in range(3):
        for k in range(4):
            gap[i] += P[i, k] * (taught[k // 2, k % 2] - expected[k])
    return gap


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
    stored, monitor, rcm = tick.stored, tick.stored.monitor, make_rcm_struct(tick.parameters)
    p1, sampled = stored.estimate.p1, monitor.sampled_p1
    place, before = (p1[0], p1[1], p1[2]), (sampled[0], sampled[1], sampled[2])
    is_near = compute_point_distance(place, compute_position_tuple(rcm, tick.setpoint.q)) < NEAR_MM
    if is_near or compute_point_distance(place, before) < MIN_SAMPLE_MM:
        return
    H = compute_markers_jacobian(stored.projection_fit, p1, make_tool_struct(tick.parameters))
    px_per_mm = max(compute_norm(H[0]), compute_norm(H[1]), 1e-6)
    squared_px = 0.5 * compute_norm(monitor.mean_residual) ** 2
    monitor.residual_sums[0] += squared_px / px_per_mm**2
    monitor.residual_sums[1] += 1.0
    for i in range(3):
        sampled[i] = p1[i]


@compiled
def arrives_elsewhere(tick: TickContext) -> bool:
    """Return True if the predicted gap exceeds what is allowed."""
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    fit, monitor, thresholds = stored.projection_fit, stored.monitor, parameters.thresholds
    rcm, shaft = make_rcm_struct(parameters), make_tool_struct(parameters)
    p1_d = compute_position_tuple(rcm, setpoint.q)
    p1 = compute_position_tuple(rcm, tick.observation.q)
    way_mm = compute_point_distance(p1, p1_d)
    if not way_mm <= MAX_WAY_MM:
        return False
    H, P = compute_markers_jacobian(fit, p1_d, shaft), np.empty((3, 4))
    damping = min(compute_arm_error(monitor), MAX_ARM_ERROR_MM)
    if not write_damped_pseudoinverse(H, damping, P):
        return False
    expected = expect_taught_markers(fit, p1_d, shaft, monitor.mean_residual)
    gap_mm = compute_norm(compute_gap(P, setpoint.points, expected))
    C = compute_gap_covariance(fit, p1_d, shaft, H, P, thresholds.drift_frames, 0.0)
    sigmas = GAP_SIGMA_RATIO * thresholds.max_target_deviation
    deviation_mm = np.sqrt(C[0, 0] + C[1, 1] + C[2, 2])
    return gap_mm > GAP_MM + GAP_PER_WAY * way_mm + sigmas * deviation_mm


@compiled
def compute_gap_covariance(
    fit: ProjectionFit,
    p1_d: Point,
    shaft: ToolStruct,
    H: Floats,
    P: Floats,
    frames: float,
    arm_error_mm: float,
) -> Floats:
    """Return the covariance (3, 3) mm² of the gap, P R Pᵀ.

    R (4, 4) px² contains the noise of residuals that are averaged over some frames, that of the
    taught markers, the covariance of the fit, and errors of arm and tool with the standard
    deviation `arm_error_mm`.
    """
    predicted, R = project_markers(fit, p1_d, shaft), np.zeros((4, 4))
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
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    fit, monitor, thresholds = stored.projection_fit, stored.monitor, parameters.thresholds
    shaft = make_tool_struct(parameters)
    p1_d = compute_position_tuple(make_rcm_struct(parameters), setpoint.q)
    H, P = compute_markers_jacobian(fit, p1_d, shaft), np.empty((3, 4))
    has_mean = monitor.averaged_frames >= thresholds.drift_frames
    if not (has_mean and write_damped_pseudoinverse(H, 0.0, P)):
        return False
    expected = expect_taught_markers(fit, p1_d, shaft, monitor.mean_residual)
    gap = compute_gap(P, setpoint.points, expected)
    arm_error_mm = ARRIVAL_ERROR_RATIO * compute_arm_error(monitor)
    C = compute_gap_covariance(fit, p1_d, shaft, H, P, thresholds.drift_frames, arm_error_mm)
    for i in range(3):
        C[i, i] += RETURN_DEVIATION_MM**2
    max_sigma = ARRIVAL_SIGMA_RATIO * thresholds.max_target_deviation
    return invert(C) and bilinear_form(C, gap, gap) > max_sigma**2


@compiled
def bound_pose(tick: TickContext) -> float:
    """Return the distance (mm) from the taught position that marker 2 keeps with 95 %.

    With P (3, 4) of the gap, the error of the pose has the covariance

        P R Pᵀ + (2 e)² B Bᵀ,    B = I − P H

    R (4, 4) px² contains the noise of the residuals and of the target, and errors e (mm) of arm and
    tool. e is the rms of the residuals on the way without half of their noise, of which the fit has
    absorbed a part. The joints, which decide in the directions of B, have the error 2 e. The
    distance that is left to the goal is added.
    """
    stored, setpoint, parameters = tick.stored, tick.setpoint, tick.parameters
    fit, shaft = stored.projection_fit, make_tool_struct(parameters)
    rcm, q_d = make_rcm_struct(parameters), setpoint.q
    p1_d = compute_position_tuple(rcm, tick.observation.q if np.isnan(q_d[0]) else q_d)
    H, P = compute_markers_jacobian(fit, p1_d, shaft), np.empty((3, 4))
    arm_error_mm = compute_arm_error(stored.monitor)
    if not write_damped_pseudoinverse(H, select_damping(tick, arm_error_mm), P):
        return np.inf
    px_per_mm = max(compute_norm(H[0]), compute_norm(H[1]))
    residual_noise = fit.noise_variance / (parameters.thresholds.drift_frames * px_per_mm**2)
    squared_mm = max(arm_error_mm**2 - residual_noise, 0.0)
    frames = max(min(fit.offset_weight[0], fit.offset_weight[1]), 1.0)
    noise = fit.noise_variance * (1.0 / frames + 1.0 / BOUND_TEACHING_FRAMES)
    R, B = np.zeros((4, 4)), np.eye(3) - multiply_matrices(P, H)
    for i in range(4):
        R[i, i] = noise
        for j in range(4):
            R[i, j] += squared_mm * dot(H[i], H[j]) if i // 2 == j // 2 else 0.0
    C = multiply_matrices(multiply_matrices(P, R), P.T)
    joint_squared_mm = JOINT_ERROR_RATIO**2 * squared_mm
    T, variance = compute_second_marker_jacobian(shaft, np.array(p1_d)), 0.0
    for i in range(3):
        for j in range(3):
            C[i, j] += joint_squared_mm * dot(B[i], B[j])
    for i in range(3):
        variance += bilinear_form(C, T[i], T[i])
    return BOUND_FACTOR * np.sqrt(variance) + compute_goal_distance(tick)
