"""Innovation gate: compare the markers of a frame with their prediction by the projection fit.

Before a fit exists, the module bounds the motion of the markers from frame to frame. It also
compares a measured change of the features with the prediction by Ĵ. Every comparison is written so
that NaN fails it.
"""

import numpy as np

from rcmservo.estimation.camera_fit import (
    UNIT_LENGTH_MM,
    ProjectedPoint,
    ProjectionFit,
    project_markers,
)
from rcmservo.estimation.camera_fit_prediction import image_covariance
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
    compute_norm,
    divide,
    find_max_abs,
    multiply_vector,
    subtract,
)
from rcmservo.safety.thresholds import Thresholds

MAX_PIXEL_COORDINATE = 1e6
"""Absolute pixel coordinate (px) from which on a point is no detection of a marker."""


@compiled
def find_lost_markers(points: Floats) -> tuple[bool, bool]:
    """Return whether marker 1 and marker 2 are lost.

    A marker is lost if its raw pixels in `points` (2, 2) are not finite or larger than those of any
    camera.
    """
    first = abs(points[0, 0]) < MAX_PIXEL_COORDINATE and abs(points[0, 1]) < MAX_PIXEL_COORDINATE
    second = abs(points[1, 0]) < MAX_PIXEL_COORDINATE and abs(points[1, 1]) < MAX_PIXEL_COORDINATE
    return not first, not second


@compiled
def is_plausible_fit(fit: ProjectionFit, thresholds: Thresholds) -> bool:
    """Return True if the fit is plausible for a camera.

    Its rms residual must be at most `max_residual_px` px, and its depth must not change faster with
    position than in front of a camera at `min_camera_distance` mm.
    """
    steepest = UNIT_LENGTH_MM / thresholds.min_camera_distance
    return fit.noise_variance <= thresholds.max_residual_px**2 and compute_norm(fit.g) <= steepest


@compiled
def find_deviating_markers(
    fit: ProjectionFit,
    p1: Floats,
    points: Floats,
    before: Floats,
    shaft: ToolStruct,
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
    before : Floats
        Markers of the newest accepted frame, (2, 2) raw px.
    shaft : ToolStruct
        Tool, which gives the position of marker 2.
    thresholds : Thresholds
        Bounds of the comparison.

    Returns
    -------
    tuple[bool, bool, bool]
        True if marker 1 deviates from its prediction; the same for marker 2; and True if both
        deviate and each agrees with the prediction of the other.
    """
    predicted, one, two = project_markers(fit, p1, shaft), False, False
    for k in range(2):
        deviates = deviates_from_prediction(fit, predicted[k], k, points[k], before[k], thresholds)
        one, two = (deviates, two) if k == 0 else (one, deviates)
    crossed = one and two
    for k in range(2):
        crossed = crossed and not deviates_from_prediction(
            fit, predicted[k], k, points[1 - k], before[k], thresholds
        )
    return one, two, crossed


@compiled
def deviates_from_prediction(
    fit: ProjectionFit,
    predicted: ProjectedPoint,
    k: int,
    point: Floats,
    before: Floats,
    thresholds: Thresholds,
) -> bool:
    """Return True if a detection is an outlier for marker k.

    The innovation is the difference (px) between `point` (2,) and its prediction. It is first
    reduced by `model_error` px and by the fraction `timing_error_fraction` of the marker's motion
    since `before` (2,) px. The rest is an outlier if its Mahalanobis distance exceeds
    `max_innovation`, with the covariance of the fit and the noise of the detection.
    """
    u = fit.origin[3] + predicted.m[0] + fit.offset[k, 0]
    v = fit.origin[4] + predicted.m[1] + fit.offset[k, 1]
    error_u, error_v = point[0] - u, point[1] - v
    distance = np.sqrt(error_u * error_u + error_v * error_v)
    motion = np.sqrt((u - before[0]) ** 2 + (v - before[1]) ** 2)
    excess = distance - thresholds.model_error - thresholds.timing_error_fraction * motion
    if excess <= 0.0:
        return False
    fraction, noise = (
        excess / distance,
        fit.noise_variance * (1.0 + 1.0 / max(fit.offset_weight[k], 1.0)),
    )
    squared = squared_mahalanobis_distance(
        error_u, error_v, image_covariance(fit, predicted), noise
    )
    return not fraction * fraction * squared <= thresholds.max_innovation**2


@compiled
def squared_mahalanobis_distance(
    u: float, v: float, cov: tuple[float, float, float], noise: float
) -> float:
    """Return xᵀ (C + noise I)⁻¹ x of x = (u, v), with the entries C_uu, C_uv and C_vv in `cov`."""
    uu, uv, vv = cov[0] + noise, cov[1], cov[2] + noise
    return (vv * u**2 - 2.0 * uv * u * v + uu * v**2) / (uu * vv - uv * uv)


@compiled
def find_jumps(
    points: Floats, before: Floats, tool_motion: float, max_jump: float, max_px_per_mm: float
) -> tuple[bool, bool, bool]:
    """Detect jumps of the markers before an estimate exists.

    Parameters
    ----------
    points, before : Floats
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
    allowed = max_jump + max_px_per_mm * tool_motion
    first, second = pixel_distance(points[0], before[0]), pixel_distance(points[1], before[1])
    crossed = (
        pixel_distance(points[0], before[1]) <= allowed
        and pixel_distance(points[1], before[0]) <= allowed
    )
    return not first <= allowed, not second <= allowed, crossed


@compiled
def pixel_distance(one: Floats, other: Floats) -> float:
    """Return the distance (px) between two points (2,)."""
    return np.sqrt((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2)


@compiled
def compare_with_estimate(
    points: Floats,
    before: Floats,
    o_c: Floats,
    J_hat: Floats,
    delta_p: Floats,
    min_change: float,
    max_error: float,
) -> int:
    """Compare the change of the features with its prediction Ĵ Δp₁.

    Parameters
    ----------
    points, before : Floats
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
        0 if both agree, 1 if they disagree, and -1 if the motion is too small for a comparison.
    """
    change_hat = divide(multiply_vector(J_hat, delta_p), FEATURE_SCALE)
    size = find_max_abs(change_hat)
    if size < min_change:
        return -1
    change = compute_feature_error(
        compute_features(shift_to_rcm(points, o_c)), compute_features(shift_to_rcm(before, o_c))
    )
    error = find_max_abs(subtract(divide(change, FEATURE_SCALE), change_hat))
    return 0 if error <= min_change + max_error * size else 1
