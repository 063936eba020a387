"""Predictions of the projection fit of camera_fit.py, whose notation is used here.

The fit predicts the markers' pixels, their derivatives ∂m/∂p₁ and covariances, the accuracy of the
pose that the pixels determine, and the order of the markers along the tool.

A marker with the innovation e (px), its difference from the prediction, has the weight

    w = min(1, c²/d²),    d² = eᵀ (C + σ² I)⁻¹ e

with the covariance C of the prediction, the noise variance σ² of the fit, and c = 6. Weights of
false detections are thus small, and those of all others are 1. A false detection that counts
increases σ², and with it what the next ones may deviate by; C and σ² therefore enter with a noise
of 2 px, or of a fifth of σ if that is more. If the fit itself is wrong, right markers have small
weights, but their residuals increase σ² until they count again.
"""

import numpy as np

from rcmservo.estimation.camera_fit import (
    UNIT_LENGTH_MM,
    ProjectedPoint,
    ProjectionFit,
    project_markers,
    project_point,
)
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.geometry.kinematics import Point
from rcmservo.geometry.tool import ToolStruct, convert_to_first_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm, multiply_matrices
from rcmservo.numerics.small_solvers import invert

Row4 = tuple[float, float, float, float]
"""Row of four numbers."""

OUTLIER_SIGMA = 6.0
"""Mahalanobis distance c from which the weight of a marker falls."""

MAX_NOISE_PX = 2.0
"""Largest noise (px) that a deviation is attributed to."""

MAX_NOISE_RATIO = 5.0
"""Largest factor by which the noise is reduced to `MAX_NOISE_PX`.

A fit that contradicts most markers is wrong itself, and must follow them.
"""

MIN_OUTLIER_PX = 4.0
"""Smallest innovation (px) of a false detection; lens, arm and tool may explain a smaller one."""


@compiled
def compute_image_covariance(
    fit: ProjectionFit, prediction: ProjectedPoint
) -> tuple[float, float, float]:
    """Return the covariance (uu, uv, vv) in px² of a predicted image, by the errors of A and g."""
    d_u, d_v = differentiate_by_depth(fit, prediction)
    scale = fit.noise_variance / prediction.z**2
    uu, uv, vv = combine_errors(fit, prediction.x, d_u, d_v)
    return scale * uu, scale * uv, scale * vv


@compiled
def squared_mahalanobis_distance(
    u: float, v: float, covariance: tuple[float, float, float], noise_variance: float
) -> float:
    """Return xᵀ (C + σ² I)⁻¹ x of x = (u, v) px, with the noise variance σ² in px².

    `covariance` has the entries C_uu, C_uv and C_vv in px².
    """
    uu, uv, vv = covariance[0] + noise_variance, covariance[1], covariance[2] + noise_variance
    return (vv * u**2 - 2.0 * uv * u * v + uu * v**2) / (uu * vv - uv * uv)


@compiled
def compute_spacing_covariance(
    fit: ProjectionFit, image_1: ProjectedPoint, image_2: ProjectedPoint
) -> tuple[float, float, float]:
    """Return the covariance (uu, uv, vv) in px² of the vector from marker 1 to 2 in the image.

    The errors of A and g that move both predicted images alike have no part in it.
    """
    x_1, x_2, z_1, z_2 = image_1.x, image_2.x, image_1.z, image_2.z
    (u_1, v_1), (u_2, v_2) = (
        differentiate_by_depth(fit, image_1),
        differentiate_by_depth(fit, image_2),
    )
    x = (
        x_2[0] / z_2 - x_1[0] / z_1,
        x_2[1] / z_2 - x_1[1] / z_1,
        x_2[2] / z_2 - x_1[2] / z_1,
        x_2[3] / z_2 - x_1[3] / z_1,
    )
    d_u = u_2[0] / z_2 - u_1[0] / z_1, u_2[1] / z_2 - u_1[1] / z_1, u_2[2] / z_2 - u_1[2] / z_1
    d_v = v_2[0] / z_2 - v_1[0] / z_1, v_2[1] / z_2 - v_1[1] / z_1, v_2[2] / z_2 - v_1[2] / z_1
    uu, uv, vv = combine_errors(fit, x, d_u, d_v)
    return fit.noise_variance * uu, fit.noise_variance * uv, fit.noise_variance * vv


@compiled
def differentiate_by_depth(fit: ProjectionFit, prediction: ProjectedPoint) -> tuple[Point, Point]:
    """Return ẑ ∂u/∂g and ẑ ∂v/∂g of a predicted image, where A follows g as its best fit."""
    x, (m_u, m_v), U, V = prediction.x, prediction.m, fit.sums[1], fit.sums[2]
    S_x = multiply_inverse(fit, x)
    u_0, u_1, u_2 = multiply_row(U[0], S_x), multiply_row(U[1], S_x), multiply_row(U[2], S_x)
    v_0, v_1, v_2 = multiply_row(V[0], S_x), multiply_row(V[1], S_x), multiply_row(V[2], S_x)
    d_u = u_0 - m_u * x[0], u_1 - m_u * x[1], u_2 - m_u * x[2]
    d_v = v_0 - m_v * x[0], v_1 - m_v * x[1], v_2 - m_v * x[2]
    return d_u, d_v


@compiled
def combine_errors(
    fit: ProjectionFit, x: Row4, d_u: Point, d_v: Point
) -> tuple[float, float, float]:
    """Return the covariance (uu, uv, vv) of an image by the errors of A and of g, for σ² = 1."""
    S_x, G = multiply_inverse(fit, x), fit.g_inverse
    leverage = x[0] * S_x[0] + x[1] * S_x[1] + x[2] * S_x[2] + x[3] * S_x[3]
    uu, uv = compute_bilinear_form(G, d_u, d_u), compute_bilinear_form(G, d_u, d_v)
    vv = compute_bilinear_form(G, d_v, d_v)
    return leverage + uu, uv, leverage + vv


@compiled
def multiply_inverse(fit: ProjectionFit, x: Row4) -> Row4:
    """Return S⁻¹x̄ (4,)."""
    S = fit.S_inverse
    return (
        multiply_row(S[0], x),
        multiply_row(S[1], x),
        multiply_row(S[2], x),
        multiply_row(S[3], x),
    )


@compiled
def multiply_row(row: Floats, x: Row4) -> float:
    """Return the scalar product of a row (4,) and x."""
    return row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3] * x[3]


@compiled
def compute_bilinear_form(G: Floats, a: Point, b: Point) -> float:
    """Return aᵀGb of G (3, 3)."""
    total = 0.0
    for i in range(3):
        total += a[i] * (G[i, 0] * b[0] + G[i, 1] * b[1] + G[i, 2] * b[2])
    return total


@compiled
def write_predicted_image(fit: ProjectionFit, p: Floats, point: Floats, covariance: Floats) -> None:
    """Write the predicted raw pixels (2,) of a point p (3,) mm and their covariance (2, 2) px²."""
    prediction = project_point(fit, p)
    uu, uv, vv = compute_image_covariance(fit, prediction)
    point[0], point[1] = fit.origin[3] + prediction.m[0], fit.origin[4] + prediction.m[1]
    covariance[0, 0], covariance[0, 1], covariance[1, 0], covariance[1, 1] = uu, uv, uv, vv


@compiled
def predict_image(fit: ProjectionFit, p: Floats) -> tuple[Floats, Floats]:
    """Return the predicted raw pixels (2,) of a point p (3,) mm and their covariance (2, 2) px²."""
    point, covariance = np.empty(2), np.empty((2, 2))
    write_predicted_image(fit, p, point, covariance)
    return point, covariance


@compiled
def write_predicted_markers(
    fit: ProjectionFit, p1: Floats | Point, shaft: ToolStruct, points: Floats
) -> None:
    """Write the markers (2, 2) raw px that the fit alone predicts for p1 (3,) mm."""
    image_1, image_2 = project_markers(fit, p1, shaft)
    for i in range(2):
        points[0, i] = fit.origin[3 + i] + image_1.m[i]
        points[1, i] = fit.origin[3 + i] + image_2.m[i]


@compiled
def predict_markers(fit: ProjectionFit, p1: Floats, shaft: ToolStruct) -> Floats:
    """Return the markers (2, 2) raw px that the fit alone predicts for p1 (3,) mm."""
    points = np.empty((2, 2))
    write_predicted_markers(fit, p1, shaft, points)
    return points


@compiled
def add_offset(fit: ProjectionFit, points: Floats) -> None:
    """Add the offset of the fit to the markers (2, 2) px."""
    for k in range(2):
        for i in range(2):
            points[k, i] += fit.offset[k, i]


@compiled
def filter_markers(fit: ProjectionFit, p1: Floats, shaft: ToolStruct) -> Floats:
    """Return the markers (2, 2) raw px at p1 (3,) mm by fit plus offset."""
    points = predict_markers(fit, p1, shaft)
    add_offset(fit, points)
    return points


@compiled
def write_point_jacobian(fit: ProjectionFit, prediction: ProjectedPoint, jacobian: Floats) -> None:
    """Write ∂m/∂p (2, 3) px/mm of the fit at a point with the given prediction."""
    depth = prediction.z * UNIT_LENGTH_MM
    for i in range(3):
        jacobian[0, i] = (fit.A[0, i] - prediction.m[0] * fit.g[i]) / depth
        jacobian[1, i] = (fit.A[1, i] - prediction.m[1] * fit.g[i]) / depth


@compiled
def write_markers_jacobian(
    fit: ProjectionFit, p1: Floats | Point, shaft: ToolStruct, jacobian: Floats
) -> None:
    """Write ∂m/∂p₁ (4, 3) px/mm of both markers with marker 1 at p1 (3,) mm."""
    image_1, image_2 = project_markers(fit, p1, shaft)
    write_point_jacobian(fit, image_1, jacobian[:2])
    write_point_jacobian(fit, image_2, jacobian[2:])
    convert_to_first_marker(shaft, p1, jacobian[2:])


@compiled
def compute_markers_jacobian(fit: ProjectionFit, p1: Floats | Point, shaft: ToolStruct) -> Floats:
    """Return ∂m/∂p₁ (4, 3) px/mm of both markers with marker 1 at p1 (3,) mm."""
    jacobian = np.empty((4, 3))
    write_markers_jacobian(fit, p1, shaft, jacobian)
    return jacobian


@compiled
def compute_fitted_features_jacobian(
    fit: ProjectionFit, p1: Floats, points: Floats, o_c: Floats, shaft: ToolStruct
) -> Floats:
    """Return Ĵ = ∂y/∂m ∂m/∂p₁ (3, 3), eq. (15), at the raw `points` (2, 2) px about o_c.

    ∂m/∂p₁ is that of the fit.
    """
    dy_dm = compute_features_jacobian(shift_to_rcm(points, o_c))
    return multiply_matrices(dy_dm, compute_markers_jacobian(fit, p1, shaft))


@compiled
def invert_normal_matrix(H: Floats, inverse: Floats) -> bool:
    """Write (HᵀH)⁻¹ (3, 3) mm²/px² of H = ∂m/∂p₁ (4, 3) px/mm; return whether it exists."""
    return invert_damped_normal_matrix(H, 0.0, inverse)


@compiled
def invert_damped_normal_matrix(H: Floats, damping: float, inverse: Floats) -> bool:
    """Write (HᵀH + λ I)⁻¹ (3, 3) mm²/px²; return whether it exists.

    λ is the square of `damping` times the largest px per mm of marker 1.
    """
    px_per_mm = max(compute_norm(H[0]), compute_norm(H[1]))
    for i in range(3):
        for j in range(3):
            inverse[i, j] = (damping * px_per_mm) ** 2 if i == j else 0.0
            for k in range(4):
                inverse[i, j] += H[k, i] * H[k, j]
    return invert(inverse)


@compiled
def write_damped_pseudoinverse(H: Floats, damping: float, P: Floats) -> bool:
    """Write P = (HᵀH + λ I)⁻¹ Hᵀ (3, 4) mm/px of H = ∂m/∂p₁ (4, 3); return whether it exists.

    λ is the square of `damping` times the largest px per mm of marker 1.
    """
    inverse = np.empty((3, 3))
    exists = invert_damped_normal_matrix(H, damping, inverse)
    for i in range(3):
        for k in range(4):
            P[i, k] = 0.0
            for j in range(3):
                P[i, k] += inverse[i, j] * H[k, j]
    return exists


@compiled
def compute_squared_dilution(fit: ProjectionFit, p1: Floats | Point, shaft: ToolStruct) -> float:
    """Return the squared dilution of precision tr(HᵀH)⁻¹ in (mm/px)².

    H (4, 3) is ∂m/∂p₁ of both markers. The result is large where the pixels hardly determine the
    pose, and infinite where they do not.
    """
    H, inverse = np.empty((4, 3)), np.empty((3, 3))
    write_markers_jacobian(fit, p1, shaft, H)
    is_determined = invert_normal_matrix(H, inverse)
    return inverse[0, 0] + inverse[1, 1] + inverse[2, 2] if is_determined else np.inf


@compiled
def compute_pose_deviation(fit: ProjectionFit, p1: Floats | Point, shaft: ToolStruct) -> float:
    """Return the standard deviation (mm) of marker 1 by the pixels of one frame: σ √tr(HᵀH)⁻¹."""
    return np.sqrt(fit.noise_variance * compute_squared_dilution(fit, p1, shaft))


@compiled
def compute_deviation_without_marker(
    fit: ProjectionFit, p1: Floats, k: int, shaft: ToolStruct
) -> float:
    """Return the standard deviation (mm) of marker 1 if a prediction replaces marker k (0 or 1).

    It is √tr(H⁺ cov H⁺ᵀ) with the covariance of the predicted marker k, and the columns of the
    pseudoinverse H⁺ (3, 4) that belong to it.
    """
    H, inverse, total = np.empty((4, 3)), np.empty((3, 3)), 0.0
    write_markers_jacobian(fit, p1, shaft, H)
    if not invert_normal_matrix(H, inverse):
        return np.inf
    image_1, image_2 = project_markers(fit, p1, shaft)
    uu, uv, vv = compute_image_covariance(fit, image_1 if k == 0 else image_2)
    for i in range(3):
        per_u, per_v = 0.0, 0.0
        for j in range(3):
            per_u += inverse[i, j] * H[2 * k, j]
            per_v += inverse[i, j] * H[2 * k + 1, j]
        total += uu * per_u * per_u + 2.0 * uv * per_u * per_v + vv * per_v * per_v
    return np.sqrt(total)


@compiled
def compute_marker_order_score(fit: ProjectionFit) -> float:
    """Return the score of the marker order: about 1, or −1 if the markers are exchanged.

    A marker that moves from the position of marker 1 to that of marker 2 should move in the image
    by the vector between both. The score is its predicted motion along that vector, as a fraction
    of its length. The prediction uses the motions of each marker by itself: the vector between both
    markers would be reversed if they are exchanged.
    """
    cov_xx, cov_xm, difference = np.zeros((3, 3)), np.zeros((3, 2)), np.empty(5)
    for i in range(3):
        for j in range(3):
            cov_xx[i, j] = fit.sums[0, i, j]
        for n in range(2):
            cov_xm[i, n] = fit.sums[1 + n, i, 3]
        for k in range(2):
            mean = fit.marker_sums[k, i] / fit.marker_sums[k, 5]
            for j in range(3):
                cov_xx[i, j] -= mean * fit.marker_sums[k, j]
            for n in range(2):
                cov_xm[i, n] -= mean * fit.marker_sums[k, 3 + n]
    is_invertible = invert(cov_xx)
    for i in range(5):
        mean_1 = fit.marker_sums[0, i] / fit.marker_sums[0, 5]
        difference[i] = fit.marker_sums[1, i] / fit.marker_sums[1, 5] - mean_1
    progress, squared_length = 0.0, difference[3] ** 2 + difference[4] ** 2
    for n in range(2):
        for i in range(3):
            for j in range(3):
                progress += difference[3 + n] * cov_xm[i, n] * cov_xx[i, j] * difference[j]
    return progress / squared_length if is_invertible and squared_length > 0.0 else 0.0


@compiled
def weigh_markers(fit: ProjectionFit, p1: Floats, points: Floats, shaft: ToolStruct) -> None:
    """Write `fit.marker_weights` of a frame with the raw `points` (2, 2) px at p1 (3,) mm.

    A marker before the first frame, or one that is lost (NaN), has the weight 1.
    """
    predictions = project_markers(fit, p1, shaft)
    for k in range(2):
        fit.marker_weights[k] = compute_weight(fit, predictions[k], points[k])


@compiled
def compute_weight(fit: ProjectionFit, prediction: ProjectedPoint, point: Floats) -> float:
    """Return the weight of a marker at `point` (2,) raw px, from 0 to 1."""
    u = point[0] - fit.origin[3] - prediction.m[0]
    v = point[1] - fit.origin[4] - prediction.m[1]
    if not u * u + v * v > MIN_OUTLIER_PX**2:
        return 1.0
    covariance = compute_image_covariance(fit, prediction)
    squared = squared_mahalanobis_distance(u, v, covariance, fit.noise_variance)
    squared *= min(max(fit.noise_variance / MAX_NOISE_PX**2, 1.0), MAX_NOISE_RATIO**2)
    if not squared > OUTLIER_SIGMA**2:
        return 1.0
    return OUTLIER_SIGMA**2 / squared
