"""Inverses and solutions of small linear systems, for compiled functions.

There is one function for each kind of matrix: `invert` for positive definite ones of any size
(covariances, normal equations), `solve_3x3` for the Jacobian of three features, `solve_2x2` for a
positive definite matrix that may be nearly singular. LAPACK takes longer at this size, mostly for
the call, and seconds to compile.
"""

import numpy as np

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Floats

Vector = tuple[float, float, float]
"""Vector of three numbers."""

MIN_ROOT_COSINE = 1e-5 - 1.0
"""Cosine of the angle in `compute_norm_squared` above which the largest two roots are distinct."""


@compiled
def invert(X: Floats) -> bool:
    """Replace a symmetric positive definite X (n, n) by its inverse, by Gauss-Jordan elimination.

    Return False if a pivot is not positive: X is not positive definite, or contains NaN. X is then
    partly eliminated and must not be used.
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
                factor = X[i, k]
                X[i, k] = 0.0
                for j in range(n):
                    X[i, j] -= factor * X[k, j]
    return True


@compiled
def solve_2x2(N: Floats, b: Floats) -> Floats:
    """Return x (2,) of N x = b, for a symmetric positive definite N (2, 2).

    The larger pivot is eliminated first. Unlike `invert`, this preserves the digits up to a
    condition of 1e12, which the lines of a slow motion have.
    """
    i = 0 if N[0, 0] >= N[1, 1] else 1
    factor, x = N[0, 1] / N[i, i], np.empty(2)
    x[1 - i] = (b[1 - i] - factor * b[i]) / (N[1 - i, 1 - i] - factor * N[0, 1])
    x[i] = (b[i] - N[0, 1] * x[1 - i]) / N[i, i]
    return x


@compiled
def solve_3x3(A: Floats, b: Floats) -> tuple[Vector, float]:
    """Return x of A x = b for any A (3, 3) and b (3,) by the minors of A, and its condition number.

    The condition |A||A⁻¹| has a relative error of about 1e-16 times its square, so no digit of a
    large one is certain. It is NaN where the two largest or the two smallest singular values are
    nearly equal.
    """
    row_1, row_2 = (A[0, 0], A[0, 1], A[0, 2]), (A[1, 0], A[1, 1], A[1, 2])
    row_3 = A[2, 0], A[2, 1], A[2, 2]
    u, v = vector_product(row_2, row_3), vector_product(row_3, row_1)
    w = vector_product(row_1, row_2)
    det = scalar_product(row_1, u)
    inverse_1 = u[0] / det, v[0] / det, w[0] / det
    inverse_2 = u[1] / det, v[1] / det, w[1] / det
    inverse_3 = u[2] / det, v[2] / det, w[2] / det
    rhs = b[0], b[1], b[2]
    x, y = scalar_product(inverse_1, rhs), scalar_product(inverse_2, rhs)
    inverse_norm_squared = compute_norm_squared(inverse_1, inverse_2, inverse_3)
    condition_squared = compute_norm_squared(row_1, row_2, row_3) * inverse_norm_squared
    return (x, y, scalar_product(inverse_3, rhs)), np.sqrt(condition_squared)


@compiled
def compute_norm_squared(row_1: Vector, row_2: Vector, row_3: Vector) -> float:
    """Return the square of the largest singular value of a matrix of three rows.

    It is the largest root of the characteristic polynomial of A Aᵀ, by the cosine of a third of an
    angle: O. K. Smith, Eigenvalues of a symmetric 3 x 3 matrix, Comm. ACM 4 (1961) 168. It is NaN
    where this root is nearly a double root, whose angle has only half the digits.
    """
    a, b = scalar_product(row_1, row_1), scalar_product(row_2, row_2)
    c, d = scalar_product(row_3, row_3), scalar_product(row_1, row_2)
    e, f = scalar_product(row_1, row_3), scalar_product(row_2, row_3)
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    size = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if size == 0.0:
        return mean
    det = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    cosine = 0.5 * det / size**3
    if not cosine > MIN_ROOT_COSINE:
        return np.nan
    return mean + 2.0 * size * np.cos(np.arccos(min(cosine, 1.0)) / 3.0)


@compiled
def vector_product(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def scalar_product(a: Vector, b: Vector) -> float:
    """Return aᵀb."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
