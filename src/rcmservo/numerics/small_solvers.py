"""Inverses and solutions of small linear systems, for compiled functions.

One function for each kind of matrix: `invert` for positive definite ones of any size (covariances,
normal equations), `invert_3x3` for the Jacobian of three features, `solve_2x2` where a positive
definite matrix may be nearly singular. LAPACK's functions take longer at this size, of which most
is the call, and seconds to compile.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats

ALIKE = 1e-5 - 1.0
"""Cosine of the angle below which two roots of a cubic are taken to be nearly equal."""


@compiled
def invert(X: Floats) -> bool:
    """Replace a symmetric positive definite X (n, n) by its inverse, by Gauss-Jordan elimination.

    Return False, with X spoilt, if a pivot is not positive: X is not positive definite, or not a
    number.
    """
    n = len(X)
    for k in range(n):
        pivot = X[k, k]
        if not pivot > 0.0:
            return False
        X[k, k] = 1.0
        for j in range(n):
            X[k, j] /= pivot
        for i in range(n):
            if i != k:
                share = X[i, k]
                X[i, k] = 0.0
                for j in range(n):
                    X[i, j] -= share * X[k, j]
    return True


@compiled
def solve_2x2(N: Floats, b: Floats) -> Floats:
    """Return x (2,) of N x = b, for a symmetric positive definite N (2, 2).

    The larger pivot is eliminated first: unlike `invert` it keeps its digits up to the condition of
    1e12 that the lines of a slow motion have.
    """
    i = 0 if N[0, 0] >= N[1, 1] else 1
    share, x = N[0, 1] / N[i, i], np.empty(2)
    x[1 - i] = (b[1 - i] - share * b[i]) / (N[1 - i, 1 - i] - share * N[0, 1])
    x[i] = (b[i] - N[0, 1] * x[1 - i]) / N[i, i]
    return x


@compiled
def invert_3x3(A: Floats, X: Floats) -> float:
    """Write A⁻¹ of any A (3, 3) by its minors; return the condition number of A.

    That is |A||A⁻¹|, to about 1e-16 times its square, so that of a large one no digit need be true;
    NaN where the two greatest or the two least singular values are nearly equal.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for n in range(3):
            m, o = (n + 1) % 3, (n + 2) % 3
            X[n, i] = A[j, m] * A[k, o] - A[j, o] * A[k, m]
    det = A[0, 0] * X[0, 0] + A[0, 1] * X[1, 0] + A[0, 2] * X[2, 0]
    for i in range(3):
        for j in range(3):
            X[i, j] /= det
    return np.sqrt(norm_squared(A) * norm_squared(X))


@compiled
def norm_squared(A: Floats) -> float:
    """Return the square of the largest singular value of A (3, 3).

    It is the largest root of the characteristic polynomial of A Aᵀ, by the cosine of a third of an
    angle: O. K. Smith, Eigenvalues of a symmetric 3 x 3 matrix, Comm. ACM 4 (1961) 168. NaN where
    it is nearly a double root, of which the angle has half the digits only.
    """
    a, b, c = rows_product(A, 0, 0), rows_product(A, 1, 1), rows_product(A, 2, 2)
    d, e, f = rows_product(A, 0, 1), rows_product(A, 0, 2), rows_product(A, 1, 2)
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    size = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if size == 0.0:
        return mean
    det = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    turned = 0.5 * det / size**3
    if not turned > ALIKE:
        return np.nan
    return mean + 2.0 * size * np.cos(np.arccos(min(turned, 1.0)) / 3.0)


@compiled
def rows_product(A: Floats, i: int, j: int) -> float:
    """Return the scalar product of the rows i and j of A (n, 3)."""
    return A[i, 0] * A[j, 0] + A[i, 1] * A[j, 1] + A[i, 2] * A[j, 2]
