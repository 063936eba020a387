"""The singular values of a small matrix, by rotating its columns until they stand at right angles.

One-sided Jacobi rotations: at this size a tenth of the time that LAPACK's way takes, and small
values come out to full relative precision. Hestenes, "Inversion of matrices by biorthogonalization
and related results", J. SIAM 6(1), 1958.
"""

import numpy as np

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, length
from rcmservo.numerics.structs import Floats

SWEEPS = 30
"""Over all pairs of columns; they converge quadratically, three columns in about five."""


@compiled
def right_angled(A: Floats) -> tuple[Floats, Floats]:
    """B = A V (n, m) with columns at right angles, and the rotation V (m, m). The lengths of the
    columns of B are the singular values of A, in any order.
    """
    B, V = A.copy(), np.empty((A.shape[1], A.shape[1]))
    put_right(B, V)
    return B, V


@compiled
def put_right(B: Floats, V: Floats) -> None:
    """Turn the columns of B (n, m) in place until they are at right angles, and write the rotation
    V (m, m).
    """
    for i in range(len(V)):
        for j in range(len(V)):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        turned = False
        for i in range(len(V)):
            for j in range(i):
                c, s = rotation(B, i, j)
                if s != 0.0:
                    turn(B, i, j, c, s)
                    turn(V, i, j, c, s)
                    turned = True
        if not turned:
            break


@compiled
def rotation(B: Floats, i: int, j: int) -> tuple[float, float]:
    """(cos, sin) of the turn that puts the columns i and j at right angles; (1, 0) if they are."""
    across, ii, jj = 0.0, 0.0, 0.0
    for k in range(len(B)):
        across += B[k, i] * B[k, j]
        ii += B[k, i] ** 2
        jj += B[k, j] ** 2
    if not abs(across) > 1e-15 * np.sqrt(ii * jj):
        return 1.0, 0.0
    half = (jj - ii) / (2.0 * across)
    tangent = 1.0 / (abs(half) + np.sqrt(1.0 + half * half))
    c = 1.0 / np.sqrt(1.0 + tangent * tangent)
    return c, np.copysign(tangent * c, half)


@compiled
def turn(B: Floats, i: int, j: int, c: float, s: float) -> None:
    """Turn the columns i and j of B in place."""
    for k in range(len(B)):
        x, y = B[k, i], B[k, j]
        B[k, i], B[k, j] = c * x - s * y, s * x + c * y


@compiled
def condition(A: Floats) -> float:
    """The condition number of A (n, m): its largest singular value over its least; inf where A is
    not finite.
    """
    if not all_finite(A):
        return np.inf
    B, _ = right_angled(A)
    low, high = extremes(B)
    return high / low if low > 0.0 else np.inf


@compiled
def extremes(B: Floats) -> tuple[float, float]:
    """The least and the greatest length of the columns of B (n, m)."""
    low, high = np.inf, 0.0
    for i in range(B.shape[1]):
        sigma = length(B[:, i])
        low, high = min(low, sigma), max(high, sigma)
    return low, high
