"""What the servo controls: the angle s of the imaged tool and two distances r and d, eq. (6)-(9),
and their derivative.

All image points here are measured from the imaged RCM o_c. y = [s r d] in rad, px, px.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import minus

FEATURES = 3
"""How many there are."""

SCALE = np.array([np.radians(10.0), 10.0, 10.0])
"""One unit of each feature, the paper's b = 10 (10°, 10 px, 10 px): norms, conditions are those of
diag(1/SCALE) Ĵ."""


@compiled
def features(m: Floats) -> Floats:
    """y = [s r d], eq. (7)-(9), of m = [u₁ v₁ u₂ v₂] (4,) px from the imaged RCM."""
    du, dv = m[2] - m[0], m[3] - m[1]
    return np.array([np.arctan2(dv, du), np.sqrt(m[0] ** 2 + m[1] ** 2), np.sqrt(du**2 + dv**2)])


@compiled
def features_jacobian(m: Floats) -> Floats:
    """∂y/∂m (3, 4), the first factor of eq. (15); not finite where the markers coincide or m₁ is
    the imaged RCM."""
    du, dv = m[2] - m[0], m[3] - m[1]
    d = np.sqrt(du**2 + dv**2)
    r = np.sqrt(m[0] ** 2 + m[1] ** 2)
    return np.array(
        [
            [dv / d**2, -du / d**2, -dv / d**2, du / d**2],
            [m[0] / r, m[1] / r, 0.0, 0.0],
            [-du / d, -dv / d, du / d, dv / d],
        ]
    )


@compiled
def difference(y: Floats, y_d: Floats) -> Floats:
    """Δy = y − y_d (3,) with the angle wrapped to (−π, π]."""
    delta = minus(y, y_d)
    delta[0] = -((np.pi - delta[0]) % (2.0 * np.pi)) + np.pi
    return delta


@compiled
def about(points: Floats, o_c: Floats) -> Floats:
    """m (4,) px from the imaged RCM, of raw marker pixels (2, 2) or (4,): the shift of the origin
    to o_c."""
    m = np.empty(4)
    for k, pixel in enumerate(points.flat):
        m[k] = pixel - o_c[k % 2]
    return m


@compiled
def measured(points: Floats, target: Floats, o_c: Floats) -> tuple[Floats, Floats]:
    """y and Δy = y − y_d (3,) of raw pixels (2, 2) and a target's (2, 2), both about the same
    imaged RCM."""
    y = features(about(points, o_c))
    return y, difference(y, features(about(target, o_c)))
