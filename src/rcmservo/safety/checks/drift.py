"""Detectors of markers that drift away from their prediction, or that do not move with the tool.

The residual is the difference between a detected marker and its prediction by the projection fit.
The innovation gate (innovation.py) detects a large residual in one frame. A camera that pans,
rolls, zooms or approaches, or an object that is detected as a marker and slides along, causes a
small residual in every frame. The mean over a third of a second shows it, because averaging reduces
the noise.
"""

import numpy as np

from rcmservo.estimation.camera_fit import ProjectedPoint, ProjectionFit, project_markers
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    squared_mahalanobis_distance,
    write_point_jacobian,
)
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_distance, compute_norm, copy_into
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.monitor_state import MonitorState
from rcmservo.safety.thresholds import Thresholds

STUCK_MOTION_RATIO = 5.0
"""A marker stands still if the other one moves by more than this multiple of its largest motion."""

MAX_STILL_PATH_MM = 25.0
"""A marker stands still if marker 1 moves along a longer path (mm) while it does not."""

ARM_ERROR_FACTOR = 8.0
"""Mean residual that an arm's errors explain, as a multiple of their rms on the way."""

MAX_ARM_ERROR_RATIO = 1.7
"""Largest such residual, as a multiple of `max_arm_error`."""

MIN_NAMED_ERROR_MM = 0.1
"""Errors (mm, rms) on the way that a stop mentions; those of an ideal arm are below 0.05."""

SINGLE_DRIFT_RATIO = 3.0
"""A marker drifts alone if its mean residual exceeds this multiple of the other's."""


@compiled
def update_drift(
    monitor: MonitorState,
    fit: ProjectionFit,
    p1: Floats,
    points: Floats,
    tool: ToolStruct,
    has_arrived: bool,
    thresholds: Thresholds,
) -> None:
    """Update the mean residuals with a new frame.

    Parameters
    ----------
    monitor : MonitorState
        State of the checks; updated.
    fit : ProjectionFit
        Fit of the camera's projection.
    p1 : Floats
        Position of marker 1, (3,) mm.
    points : Floats
        Markers, (2, 2) raw px; a lost one is replaced by its prediction.
    tool : ToolStruct
        Tool, which gives the position of marker 2.
    has_arrived : bool
        True at the target if the joints confirm it.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    predicted = project_markers(fit, p1, tool)
    monitor.averaged_frames = min(monitor.averaged_frames + 1, thresholds.drift_frames)
    for k in range(2):
        update_mean_residual(monitor, fit, k, predicted[k], points[k], has_arrived, thresholds)


@compiled
def detect_still_markers(
    monitor: MonitorState, p1: Floats, points: Floats, is_exploring: bool, thresholds: Thresholds
) -> tuple[bool, bool]:
    """Detect a marker that does not move with the tool before an estimate exists.

    Either the other marker moves, or the tool does while it explores.

    Parameters
    ----------
    monitor : MonitorState
        State of the checks; updated.
    p1 : Floats
        Position of marker 1, (3,) mm.
    points : Floats
        Markers, (2, 2) raw px.
    is_exploring : bool
        True while the tool explores.
    thresholds : Thresholds
        Thresholds of the checks.

    Returns
    -------
    tuple[bool, bool]
        True if marker 1 stands still, and the same for marker 2.
    """
    step_mm, max_motion_px = 0.0, STUCK_MOTION_RATIO * thresholds.stuck_marker_px
    if is_exploring and all_finite(monitor.path_p1):
        step_mm = compute_distance(p1, monitor.path_p1)
    copy_into(monitor.path_p1, p1)
    monitor.still_markers = 0
    for k in range(2):
        anchor, other_anchor = monitor.stuck_anchors[k, :2], monitor.stuck_anchors[k, 2:]
        if not compute_distance(points[k], anchor) <= thresholds.stuck_marker_px:
            copy_into(anchor, points[k])
            copy_into(other_anchor, points[1 - k])
            monitor.still_paths[k] = 0.0
        monitor.still_paths[k] = monitor.still_paths[k] + step_mm if is_exploring else 0.0
        other_motion_px = compute_distance(points[1 - k], other_anchor)
        if other_motion_px > max_motion_px or monitor.still_paths[k] > MAX_STILL_PATH_MM:
            monitor.still_markers |= 1 << k
    return monitor.still_markers & 1 != 0, monitor.still_markers & 2 != 0


@compiled
def update_mean_residual(
    monitor: MonitorState,
    fit: ProjectionFit,
    k: int,
    predicted: ProjectedPoint,
    point: Floats,
    has_arrived: bool,
    thresholds: Thresholds,
) -> None:
    """Update the mean residual of marker k, and find out if noise and errors of the arm explain it.

    `point` (2,) is the marker in raw px. Its residual is clipped, so that as many false detections
    as may be rejected in succession cannot move the mean by `max_drift_px`.
    """
    prediction, mean = monitor.markers_prediction[k], monitor.mean_residual[k]
    prediction[0], prediction[1] = fit.origin[3] + predicted.m[0], fit.origin[4] + predicted.m[1]
    most_outliers = np.sqrt(2.0) * (thresholds.max_rejected_frames + 1)
    bound_px = thresholds.max_drift_px * thresholds.drift_frames / most_outliers
    for i in range(2):
        clipped_residual = min(max(point[i] - prediction[i], -bound_px), bound_px)
        mean[i] += (clipped_residual - mean[i]) / monitor.averaged_frames
    mean_variance = fit.noise_variance / monitor.averaged_frames
    mean_px = compute_norm(mean)
    max_squared_sigma = thresholds.max_drift_sigma**2
    # the covariance of the fit only adds to the noise: it is not needed for a small residual
    is_noise = mean_px * mean_px <= max_squared_sigma * mean_variance
    if not is_noise:
        covariance = compute_image_covariance(fit, predicted)
        distance = squared_mahalanobis_distance(mean[0], mean[1], covariance, mean_variance)
        is_noise = not distance > max_squared_sigma
    monitor.drift_px[k] = 0.0 if is_noise else mean_px
    exceeds_px = monitor.drift_px[k] > thresholds.max_drift_px
    arm_error_mm = bound_arm_error(monitor, has_arrived, thresholds)
    is_drift = exceeds_px and not arm_explains(fit, predicted, mean, arm_error_mm, thresholds)
    monitor.drifts[k] = 1.0 if is_drift else 0.0


@compiled
def compute_arm_error(monitor: MonitorState) -> float:
    """Return the rms (mm) of the mean residuals on the way to the target, 0 before."""
    return np.sqrt(monitor.residual_sums[0] / max(monitor.residual_sums[1], 1.0))


def describe_arm_error(monitor: MonitorState) -> str:
    """Describe large errors of arm, tool and lens on the way; empty if they were small."""
    squares, count = monitor.residual_sums
    arm_error_mm = np.sqrt(squares / max(count, 1.0))
    if not arm_error_mm > MIN_NAMED_ERROR_MM:
        return ""
    return (
        f"arm, tool and lens had errors of {arm_error_mm:.2f} mm (rms) on the way, as by backlash, "
        "bending, or markers off the axis"
    )


@compiled
def bound_arm_error(monitor: MonitorState, has_arrived: bool, thresholds: Thresholds) -> float:
    """Return the largest error (mm) of arm and tool, `max_arm_error` or up to 1.7 times.

    It is larger for an arm with larger residuals on the way, and at the target, where it reverses
    its motion and the joints bound the error too.
    """
    largest_mm = MAX_ARM_ERROR_RATIO * thresholds.max_arm_error
    learned_mm = ARM_ERROR_FACTOR * compute_arm_error(monitor)
    if has_arrived:
        return largest_mm
    return max(min(learned_mm, largest_mm), thresholds.max_arm_error)


@compiled
def arm_explains(
    fit: ProjectionFit,
    predicted: ProjectedPoint,
    mean: Floats,
    arm_error_mm: float,
    thresholds: Thresholds,
) -> bool:
    """Return True if errors of arm and tool explain the mean residual (2,) px of a marker.

    With J = ∂m/∂p (2, 3) px/mm of the marker they explain r if rᵀ(a² I + b² J Jᵀ)⁻¹ r ≤ 1, with a =
    `max_drift_px` and the error b.
    """
    J = np.empty((2, 3))
    write_point_jacobian(fit, predicted, J)
    squared_mm = arm_error_mm**2
    covariance = (
        squared_mm * (J[0, 0] ** 2 + J[0, 1] ** 2 + J[0, 2] ** 2),
        squared_mm * (J[0, 0] * J[1, 0] + J[0, 1] * J[1, 1] + J[0, 2] * J[1, 2]),
        squared_mm * (J[1, 0] ** 2 + J[1, 1] ** 2 + J[1, 2] ** 2),
    )
    squared_px = thresholds.max_drift_px**2
    return squared_mahalanobis_distance(mean[0], mean[1], covariance, squared_px) <= 1.0


@compiled
def markers_deviate(facts: TickFacts) -> bool:
    """Return True if the mean residual of a marker is too large."""
    monitor, thresholds = facts.monitor, facts.thresholds
    has_mean = monitor.averaged_frames >= thresholds.drift_frames and not monitor.image_frozen
    drifts = monitor.drifts[0] > 0.0 or monitor.drifts[1] > 0.0
    return facts.exploration_state.is_done and has_mean and drifts


@compiled
def one_marker_deviates(facts: TickFacts) -> bool:
    """Return True if the mean residual of one marker alone is too large."""
    first_px, second_px = facts.monitor.drift_px[0], facts.monitor.drift_px[1]
    exceeds_other = max(first_px, second_px) > SINGLE_DRIFT_RATIO * min(first_px, second_px)
    return markers_deviate(facts) and exceeds_other


@compiled
def markers_drift(facts: TickFacts) -> bool:
    """Detect that both markers drift away from their prediction."""
    return markers_deviate(facts) and not one_marker_deviates(facts)
