"""Feature vector of the imaged tool and its derivatives, eq. (6)-(9) and (15).

The vector is y = [s r d] in rad, px, px: the angle s of the imaged tool, the distance r of marker 1
from the imaged RCM, and the distance d between the markers. Image points named m are measured from
the imaged RCM o_c, those named `points` are raw pixels.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import subtract

FEATURE_COUNT = 3
"""Dimension of y = [s r d]."""

MAX_FEATURES = 8
"""Largest dimension of a feature vector that compiled functions reserve memory for."""

INTERPRETED_CODE, SRD_CODE, POINTS_CODE = range(3)
"""Codes of the feature vectors in compiled functions; INTERPRETED_CODE is one that Python
computes."""

FEATURE_SCALE = np.array([np.radians(10.0), 10.0, 10.0])
"""Unit of each feature: 10°, 10 px, 10 px. Ĵ is divided by it, row by row, before its norm or its
condition number is computed; otherwise both would depend on the units of y."""


@compiled
def compute_features(m: Floats) -> Floats:
    """Return y = [s r d] (rad, px, px), eq. (7)-(9), of m = [u₁ v₁ u₂ v₂] (4,) px.

    s = atan2(v₂ − v₁, u₂ − u₁), r = |(u₁, v₁)|, d = |(u₂ − u₁, v₂ − v₁)|.
    """
    du, dv = m[2] - m[0], m[3] - m[1]
    return np.array([np.arctan2(dv, du), np.sqrt(m[0] ** 2 + m[1] ** 2), np.sqrt(du**2 + dv**2)])


@compiled
def compute_features_jacobian(m: Floats) -> Floats:
    """Return ∂y/∂m (3, 4), the first factor of eq. (15).

    It is not finite where the markers coincide or marker 1 is the imaged RCM.
    """
    du, dv = m[2] - m[0], m[3] - m[1]
    d = np.sqrt(du**2 + dv**2)
    r = np.sqrt(m[0] ** 2 + m[1] ** 2)
    jacobian = np.zeros((3, 4))
    jacobian[0, 2], jacobian[0, 3] = -dv / d**2, du / d**2
    jacobian[1, 0], jacobian[1, 1] = m[0] / r, m[1] / r
    jacobian[2, 2], jacobian[2, 3] = du / d, dv / d
    for k in range(2):
        jacobian[0, k], jacobian[2, k] = -jacobian[0, 2 + k], -jacobian[2, 2 + k]
    return jacobian


@compiled
def compute_feature_error(y: Floats, y_d: Floats) -> Floats:
    """Return the error Δy = y − y_d (3,) with its angle in (−π, π]."""
    delta = subtract(y, y_d)
    delta[0] = wrap_angle(delta[0])
    return delta


@compiled
def wrap_angle(angle: float) -> float:
    """Return the angle (rad) in (−π, π] that differs by whole turns from `angle`."""
    below_pi = np.pi - angle
    if not 0.0 <= below_pi < 2.0 * np.pi:
        below_pi %= 2.0 * np.pi
    return -below_pi + np.pi


@compiled
def shift_to_rcm(points: Floats, o_c: Floats) -> Floats:
    """Return m (4,) px: raw marker pixels, (2, 2) or (4,), measured from o_c (2,) px."""
    m = np.empty(4)
    write_shifted_to_rcm(points, o_c, m)
    return m


@compiled
def write_shifted_to_rcm(points: Floats, o_c: Floats | tuple[float, float], m: Floats) -> None:
    """Write raw marker pixels, measured from o_c, into m (4,) px."""
    for k in range(4):
        m[k] = points.flat[k] - o_c[k % 2]


@compiled
def compute_line_features(m: Floats) -> tuple[float, float, float]:
    """Return s, r, d (rad, px, px) of the line through the imaged RCM nearest to m (4,) px.

    The angle of this line comes from the long distance between RCM and markers, and not from the
    short distance between the markers. Pixel noise therefore disturbs it less than eq. (7).
    """
    c, s = compute_line_direction(m)
    r = c * m[0] + s * m[1]
    return np.arctan2(s, c), r, c * m[2] + s * m[3] - r


@compiled
def compute_principal_direction(
    diagonal_difference: float, cross_term: float
) -> tuple[float, float]:
    """Return (cos θ, sin θ) of θ = ½ atan2(cross_term, diagonal_difference).

    θ is the main direction of points (x, y) whose scatter matrix has Σx² − Σy² =
    `diagonal_difference` and 2 Σxy = `cross_term` (or both in the same ratio). Points without a
    main direction give (1, 0).
    """
    size = np.sqrt(diagonal_difference * diagonal_difference + cross_term * cross_term)
    if size == 0.0:
        return 1.0, 0.0
    if diagonal_difference > 0.0:
        c = np.sqrt(0.5 * (size + diagonal_difference) / size)
        return c, 0.5 * cross_term / (size * c)
    s = np.sqrt(0.5 * (size - diagonal_difference) / size)
    return 0.5 * cross_term / (size * s), s


@compiled
def compute_line_direction(m: Floats) -> tuple[float, float]:
    """Return (cos s, sin s) of the line through the imaged RCM nearest to both markers m (4,) px.

    The direction points from the imaged RCM to the markers.
    """
    diagonal_difference = m[0] ** 2 - m[1] ** 2 + m[2] ** 2 - m[3] ** 2
    c, s = compute_principal_direction(diagonal_difference, 2.0 * (m[0] * m[1] + m[2] * m[3]))
    sign = 1.0 if c * (m[0] + m[2]) + s * (m[1] + m[3]) >= 0.0 else -1.0
    return sign * c, sign * s


@compiled
def write_line_features_jacobian(m: Floats, J: Floats) -> None:
    """Write ∂y/∂m of `compute_line_features` at m (4,) px into J (3, 4)."""
    # s = ½ atan2(cross_term, diagonal_difference), with the entries of the scatter matrix Σ m mᵀ
    diagonal_difference = m[0] ** 2 - m[1] ** 2 + m[2] ** 2 - m[3] ** 2
    cross_term = 2.0 * (m[0] * m[1] + m[2] * m[3])
    squared = diagonal_difference**2 + cross_term**2
    for k in range(4):
        sign, partner = (1.0, m[k + 1]) if k % 2 == 0 else (-1.0, m[k - 1])
        J[0, k] = (diagonal_difference * partner - cross_term * sign * m[k]) / squared
    c, s = compute_line_direction(m)
    normal_1, normal_2 = c * m[1] - s * m[0], c * m[3] - s * m[2]
    for k in range(4):
        direction, is_marker_1 = (c if k % 2 == 0 else s), (1.0 if k < 2 else 0.0)
        J[1, k] = is_marker_1 * direction + normal_1 * J[0, k]
        J[2, k] = (1.0 - is_marker_1) * direction + normal_2 * J[0, k] - J[1, k]


@compiled
def limit_origin_distance(o_c: Floats, points: Floats, max_distance: float) -> tuple[float, float]:
    """Return o_c (2,) px, moved to at most `max_distance` px from the midpoint of both markers.

    It moves on the straight line to that midpoint. `points` (2, 2) are raw pixels.
    """
    u, v = 0.5 * (points[0, 0] + points[1, 0]), 0.5 * (points[0, 1] + points[1, 1])
    du, dv = o_c[0] - u, o_c[1] - v
    fraction = min(max_distance / np.sqrt(du**2 + dv**2), 1.0)
    return u + fraction * du, v + fraction * dv


@compiled
def compute_features_and_error(
    points: Floats, target: Floats, o_c: Floats
) -> tuple[Floats, Floats]:
    """Return y and Δy = y − y_d (3,), both measured from o_c (2,) px.

    `points` and `target` are raw marker pixels (2, 2), observed and desired.
    """
    y = compute_features(shift_to_rcm(points, o_c))
    return y, compute_feature_error(y, compute_features(shift_to_rcm(target, o_c)))
