"""What the servo controls: the angle s of the imaged tool and two distances r and d, eq. (6)-(9),
and their derivative.

All image points here are measured from the imaged RCM o_c. y = [s r d] in rad, px, px.
"""

import numpy as np

from rcmservo.geometry.imaged_rcm import principal
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import minus

FEATURES = 3
"""How many there are."""

MAX_FEATURES = 8
"""Largest dimension of a feature vector."""

INTERPRETED, SRD, POINTS = range(3)
"""Codes of the feature vectors in compiled functions."""

SCALE = np.array([np.radians(10.0), 10.0, 10.0])
"""One unit of each feature, the paper's b = 10 (10°, 10 px, 10 px): norms, conditions are those of
diag(1/SCALE) Ĵ."""


@compiled
def features(m: Floats) -> Floats:
    """Y = [s r d], eq. (7)-(9), of m = [u₁ v₁ u₂ v₂] (4,) px from the imaged RCM."""
    du, dv = m[2] - m[0], m[3] - m[1]
    return np.array([np.arctan2(dv, du), np.sqrt(m[0] ** 2 + m[1] ** 2), np.sqrt(du**2 + dv**2)])


@compiled
def features_jacobian(m: Floats) -> Floats:
    """∂y/∂m (3, 4), the first factor of eq. (15); not finite where the markers coincide or m₁ is
    the imaged RCM.
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
def difference(y: Floats, y_d: Floats) -> Floats:
    """Δy = y − y_d (3,) with the angle wrapped to (−π, π]."""
    delta = minus(y, y_d)
    delta[0] = wrapped(delta[0])
    return delta


@compiled
def wrapped(angle: float) -> float:
    """An angle, rad, in (−π, π]."""
    short = np.pi - angle
    if not 0.0 <= short < 2.0 * np.pi:
        short %= 2.0 * np.pi
    return -short + np.pi


@compiled
def about(points: Floats, o_c: Floats) -> Floats:
    """M (4,) px from the imaged RCM, of raw marker pixels (2, 2) or (4,): the shift of the origin
    to o_c.
    """
    m = np.empty(4)
    shift(points, o_c, m)
    return m


@compiled
def shift(points: Floats, o_c: Floats | tuple[float, float], m: Floats) -> None:
    """Write it over m (4,)."""
    for k in range(4):
        m[k] = points.flat[k] - o_c[k % 2]


@compiled
def straight(m: Floats) -> Floats:
    """Y = [s r d] of the line through the origin that passes nearest to both markers m (4,) px: the
    imaged tool, told by the long way from the RCM instead of by the short one between them.
    """
    angle, r, d = along_line(m)
    return np.array([angle, r, d])


@compiled
def along_line(m: Floats) -> tuple[float, float, float]:
    """The same as three numbers."""
    c, s = heading(m)
    r = c * m[0] + s * m[1]
    return np.arctan2(s, c), r, c * m[2] + s * m[3] - r


@compiled
def heading(m: Floats) -> tuple[float, float]:
    """The cosine and sine of that line's angle, from the origin to the markers."""
    along = m[0] ** 2 - m[1] ** 2 + m[2] ** 2 - m[3] ** 2
    c, s = principal(along, 2.0 * (m[0] * m[1] + m[2] * m[3]))
    way = 1.0 if c * (m[0] + m[2]) + s * (m[1] + m[3]) >= 0.0 else -1.0
    return way * c, way * s


@compiled
def straight_jacobian(m: Floats, J: Floats) -> None:
    """Write ∂y/∂m of `straight` over J (3, 4)."""
    c, s = heading(m)
    along = m[0] ** 2 - m[1] ** 2 + m[2] ** 2 - m[3] ** 2
    across = 2.0 * (m[0] * m[1] + m[2] * m[3])
    for k in range(4):
        sign, other = (1.0, m[k + 1]) if k % 2 == 0 else (-1.0, m[k - 1])
        J[0, k] = (along * other - across * sign * m[k]) / (along**2 + across**2)
    beside_1, beside_2 = c * m[1] - s * m[0], c * m[3] - s * m[2]
    for k in range(4):
        forward, near = (c if k % 2 == 0 else s), (1.0 if k < 2 else 0.0)
        J[1, k] = near * forward + beside_1 * J[0, k]
        J[2, k] = (1.0 - near) * forward + beside_2 * J[0, k] - J[1, k]


@compiled
def near_origin(o_c: Floats, points: Floats, reach: float) -> tuple[float, float]:
    """o_c (2,) px, or where it is further than `reach` px from the middle of the markers' `points`
    (2, 2), the point so far on the way there.
    """
    u, v = 0.5 * (points[0, 0] + points[1, 0]), 0.5 * (points[0, 1] + points[1, 1])
    du, dv = o_c[0] - u, o_c[1] - v
    share = min(reach / np.sqrt(du**2 + dv**2), 1.0)
    return u + share * du, v + share * dv


@compiled
def measured(points: Floats, target: Floats, o_c: Floats) -> tuple[Floats, Floats]:
    """Y and Δy = y − y_d (3,) of raw pixels (2, 2) and a target's (2, 2), both about the same
    imaged RCM.
    """
    y = features(about(points, o_c))
    return y, difference(y, features(about(target, o_c)))
