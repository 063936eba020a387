"""Innovation gate: comparison of the markers of a frame with their predictions.

The innovation is the difference between a detected marker and its prediction by the projection fit,
the fit of the camera's projection to all earlier frames. Before a fit exists, the module bounds the
motion of the markers from frame to frame. It also compares a measured change of the features with
its prediction by the estimated Jacobian Ĵ. Every comparison is written so that NaN fails it.
"""

import numpy as np

from rcmservo.estimation.camera_fit import (
    UNIT_LENGTH_MM,
    ProjectedPoint,
    ProjectionFit,
    project_markers,
)
from rcmservo.estimation.camera_fit_prediction import (
    compute_image_covariance,
    squared_mahalanobis_distance,
)
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    compute_feature_error,
    compute_features,
    shift_to_rcm,
)
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import (
    compute_distance,
    compute_norm,
    divide,
    find_max_abs,
    multiply_vector,
    subtract,
)
from rcmservo.safety.thresholds import Thresholds

MAX_PIXEL_COORDINATE = 1e6
"""Absolute pixel coordinate (px) from which on a point is no detection of a marker."""

ESTIMATE_CONFIRMED, ESTIMATE_CONTRADICTED, MOTION_TOO_SMALL = 0, 1, -1
"""Results of the comparison of a measured change of the features with the estimate."""


@compiled
def find_lost_markers(points: Floats) -> tuple[bool, bool]:
    """Return whether marker 1 and marker 2 are lost.

    A marker is lost if its raw pixels in `points` (2, 2) are not finite or larger than those of any
    camera.
    """
    limit = MAX_PIXEL_COORDINATE
    first_is_detected = abs(points[0, 0]) < limit and abs(points[0, 1]) < limit
    second_is_detected = abs(points[1, 0]) < limit and abs(points[1, 1]) < limit
    return not first_is_detected, not second_is_detected


@compiled
def is_plausible_fit(fit: ProjectionFit, thresholds: Thresholds) -> bool:
    """Return True if the fit is plausible for a camera.

    Its rms residual must be at most `max_residual_px` px, and its depth must not change faster with
    position than in front of a camera at `min_camera_distance` mm.
    """
    max_depth_change = UNIT_LENGTH_MM / thresholds.min_camera_distance
    has_small_residual = fit.noise_variance <= thresholds.max_residual_px**2
    return has_small_residual and compute_norm(fit.g) <= max_depth_change


@compiled
def find_deviating_markers(
    fit: ProjectionFit,
    p1: Floats,
    points: Floats,
    accepted_points: Floats,
    tool: ToolStruct,
    thresholds: Thresholds,
) -> tuple[bool, bool, bool]:
    """Compare both markers with their predictions.

    Parameters
    ----------
    fit : ProjectionFit
        Fit of the camera's projection.
    p1 : Floats
        Position of marker 1, (3,) mm, by the joints at the exposure.
    points : Floats
        Detected markers, (2, 2) raw px.
    accepted_points : Floats
        Markers of the newest accepted frame, (2, 2) raw px.
    tool : ToolStruct
        Tool, which gives the position of marker 2.
    thresholds : Thresholds
        Bounds of the comparison.

    Returns
    -------
    tuple[bool, bool, bool]
        True if marker 1 deviates from its prediction; the same for marker 2; and True if both
        deviate and each agrees with the prediction of the other.
    """
    predicted, first_deviates, second_deviates = project_markers(fit, p1, tool), False, False
    for k in range(2):  # a loop, because each call in the source is compiled in its place
        deviates = deviates_from_prediction(
            fit, predicted[k], k, points[k], accepted_points[k], thresholds
        )
        if k == 0:
            first_deviates = deviates
        else:
            second_deviates = deviates
    is_swapped = first_deviates and second_deviates
    for k in range(2):
        is_swapped = is_swapped and not deviates_from_prediction(
            fit, predicted[k], k, points[1 - k], accepted_points[k], thresholds
        )
    return first_deviates, second_deviates, is_swapped


@compiled
def deviates_from_prediction(
    fit: ProjectionFit,
    predicted: ProjectedPoint,
    k: int,
    point: Floats,
    accepted_point: Floats,
    thresholds: Thresholds,
) -> bool:
    """Return True if a detection is an outlier for marker k.

    The innovation is the difference (px) between `point` (2,) and its prediction. It is first
    reduced by `model_error` px and by the fraction `timing_error_fraction` of the marker's motion
    since `accepted_point` (2,) px. The detection is an outlier if the Mahalanobis distance of the
    reduced innovation exceeds `max_innovation`. The covariance is that of the fit and of the noise
    of a detection.
    """
    u = fit.origin[3] + predicted.m[0] + fit.offset[k, 0]
    v = fit.origin[4] + predicted.m[1] + fit.offset[k, 1]
    error_u, error_v = point[0] - u, point[1] - v
    error_px = np.sqrt(error_u * error_u + error_v * error_v)
    motion_px = np.sqrt((u - accepted_point[0]) ** 2 + (v - accepted_point[1]) ** 2)
    excess_px = error_px - thresholds.model_error - thresholds.timing_error_fraction * motion_px
    if excess_px <= 0.0:
        return False
    fraction = excess_px / error_px
    noise_variance = fit.noise_variance * (1.0 + 1.0 / max(fit.offset_weight[k], 1.0))
    covariance = compute_image_covariance(fit, predicted)
    squared = squared_mahalanobis_distance(error_u, error_v, covariance, noise_variance)
    return not fraction * fraction * squared <= thresholds.max_innovation**2


@compiled
def find_jumps(
    points: Floats,
    earlier_points: Floats,
    tool_motion: float,
    max_jump: float,
    max_px_per_mm: float,
) -> tuple[bool, bool, bool]:
    """Detect jumps of the markers before an estimate exists.

    Parameters
    ----------
    points, earlier_points : Floats
        Markers of two frames, (2, 2) raw px.
    tool_motion : float
        Distance by which the tool moved between the frames, mm.
    max_jump : float
        Largest motion of a marker of a tool at rest, px.
    max_px_per_mm : float
        Largest motion of a marker in the image per motion of the tool, px/mm.

    Returns
    -------
    tuple[bool, bool, bool]
        True if marker 1 moved further than ``max_jump + max_px_per_mm * tool_motion``; the same for
        marker 2; and True if each marker is within this distance of the other's earlier position.
    """
    limit_px = max_jump + max_px_per_mm * tool_motion
    first_stays = compute_distance(points[0], earlier_points[0]) <= limit_px
    second_stays = compute_distance(points[1], earlier_points[1]) <= limit_px
    first_is_at_second = compute_distance(points[0], earlier_points[1]) <= limit_px
    second_is_at_first = compute_distance(points[1], earlier_points[0]) <= limit_px
    return not first_stays, not second_stays, first_is_at_second and second_is_at_first


@compiled
def compare_with_estimate(
    points: Floats,
    earlier_points: Floats,
    o_c: Floats,
    J_hat: Floats,
    delta_p: Floats,
    min_change: float,
    max_error: float,
) -> int:
    """Compare the change of the features with its prediction Ĵ Δp₁.

    Parameters
    ----------
    points, earlier_points : Floats
        Markers at the end and at the start of a motion, (2, 2) raw px.
    o_c : Floats
        Imaged RCM, (2,) raw px.
    J_hat : Floats
        Estimated Jacobian Ĵ, (3, 3).
    delta_p : Floats
        Motion of marker 1, (3,) mm.
    min_change : float
        Smallest predicted change, in units of `FEATURE_SCALE`, that permits a comparison.
    max_error : float
        Largest difference as a fraction of the predicted change, in addition to ``min_change``.

    Returns
    -------
    int
        ESTIMATE_CONFIRMED, ESTIMATE_CONTRADICTED, or MOTION_TOO_SMALL for a comparison.
    """
    predicted_change = divide(multiply_vector(J_hat, delta_p), FEATURE_SCALE)
    largest_change = find_max_abs(predicted_change)
    if largest_change < min_change:
        return MOTION_TOO_SMALL
    features = compute_features(shift_to_rcm(points, o_c))
    earlier_features = compute_features(shift_to_rcm(earlier_points, o_c))
    change = compute_feature_error(features, earlier_features)
    error = find_max_abs(subtract(divide(change, FEATURE_SCALE), predicted_change))
    agrees = error <= min_change + max_error * largest_change
    return ESTIMATE_CONFIRMED if agrees else ESTIMATE_CONTRADICTED
