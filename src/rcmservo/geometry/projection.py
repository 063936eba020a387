"""Perspective projection with parameters a, eq. (3)-(5) and (10)-(13), and its linear form (18).

A camera's calibration matrix C (3, 4) has eleven degrees of freedom. In pixels measured from the
imaged RCM o_c only nine remain (Lemma 1), since then c₁₄ = c₂₄ = 0, and c₃₄ = 1 by the scale of C.
A point p mm from the RCM projects to

    m = G p / z,    z = gᵀp + 1,    a = [G₁ G₂ g]

with the rows G₁, G₂ of G (2, 3) and g (3,). The depth z is relative to the depth of the RCM.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

PARAMETER_COUNT = 9
"""Number of projection parameters a, eq. (12)."""


@compiled
def compute_depth(a: Floats, p: Floats) -> float:
    """Return z = gᵀp + 1, eq. (5) with c₃₄ = 1: depth of p over depth of the RCM, dimensionless."""
    return a[6] * p[0] + a[7] * p[1] + a[8] * p[2] + 1.0


@compiled
def project(a: Floats, p: Floats) -> Floats:
    """Return m = G p / z (2,) px of p (3,) mm, eq. (4); with an estimate of a, eq. (34)."""
    z = compute_depth(a, p)
    u = (a[0] * p[0] + a[1] * p[1] + a[2] * p[2]) / z
    v = (a[3] * p[0] + a[4] * p[1] + a[5] * p[2]) / z
    return np.array([u, v])


@compiled
def compute_projection_jacobian(a: Floats, p: Floats) -> Floats:
    """Return ∂m/∂p = (G − m gᵀ)/z (2, 3), px/mm."""
    m = project(a, p)
    z = compute_depth(a, p)
    jacobian = np.empty((2, 3))
    for j in range(3):
        jacobian[0, j] = (a[j] - m[0] * a[6 + j]) / z
        jacobian[1, j] = (a[3 + j] - m[1] * a[6 + j]) / z
    return jacobian


@compiled
def build_regressor(m: Floats, p: Floats) -> Floats:
    """Return W (2, 9) of eq. (19), with W a = m.

    For an estimate â, the projection error e of eq. (17) is W â − m.
    """
    W = np.zeros((2, PARAMETER_COUNT))
    for j in range(3):
        W[0, j] = p[j]
        W[1, 3 + j] = p[j]
        W[0, 6 + j] = -m[0] * p[j]
        W[1, 6 + j] = -m[1] * p[j]
    return W


def extract_parameters(C: Floats) -> tuple[Floats, Floats]:
    """Return a (9,) and o_c (2,) px of a calibration matrix C (3, 4) of any scale, by Lemma 1.

    The shift of the pixel origin to o_c and the scale c₃₄ = 1 remove the other parameters of C,
    eq. (10)-(12).
    """
    C = C / C[2, 3]
    o_c = C[:2, 3].copy()
    shifted = C[:2, :3] - np.outer(o_c, C[2, :3])
    return np.concatenate([shifted.ravel(), C[2, :3]]), o_c
