"""Small linear algebra as loops, for compiled functions.

Numba compiles the same arithmetic in NumPy's notation to many times the code, because that includes
broadcasting and the texts of its errors: `a[:] = b` alone becomes nineteen times as long and takes
forty times as long to compile.
"""

import numpy as np

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.structs import Floats


@compiled
def copy_into(into: Floats, numbers: Floats) -> None:
    """Copy `numbers` into an array of the same shape."""
    for i in np.ndindex(into.shape):
        into[i] = numbers[i]


@compiled
def fill(into: Floats, number: float) -> None:
    """Set all entries of an array to one number."""
    for i in np.ndindex(into.shape):
        into[i] = number


@compiled
def all_finite(numbers: Floats) -> bool:
    """Return True if all numbers are finite."""
    for number in numbers.flat:  # noqa: SIM110 Numba compiles no generators in `all`
        if not np.isfinite(number):
            return False
    return True


@compiled
def find_max_abs(numbers: Floats) -> float:
    """Return the largest absolute value; NaN if a number is NaN."""
    maximum = 0.0
    for number in numbers.flat:
        if np.isnan(number):
            return np.nan
        maximum = max(maximum, abs(number))
    return maximum


@compiled
def compute_norm(numbers: Floats) -> float:
    """Return the square root of the sum of squares: the Euclidean or Frobenius norm."""
    total = 0.0
    for number in numbers.flat:
        total += number * number
    return np.sqrt(total)


@compiled
def subtract(a: Floats, b: Floats) -> Floats:
    """Return a − b, both (n,)."""
    out = np.empty(len(a))
    for i in range(len(a)):
        out[i] = a[i] - b[i]
    return out


@compiled
def compute_distance(a: Floats, b: Floats) -> float:
    """Return the Euclidean norm of a − b, both (n,)."""
    total = 0.0
    for i in range(len(a)):
        total += (a[i] - b[i]) ** 2
    return np.sqrt(total)


@compiled
def divide(a: Floats, b: Floats) -> Floats:
    """Return a / b entry by entry, both (n,)."""
    out = np.empty(len(a))
    for i in range(len(a)):
        out[i] = a[i] / b[i]
    return out


@compiled
def dot(a: Floats, b: Floats) -> float:
    """Return aᵀb, both (n,)."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled
def bilinear_form(M: Floats, a: Floats, b: Floats) -> float:
    """Return the bilinear form aᵀMb of M (n, m), a (n,) and b (m,)."""
    total = 0.0
    for i in range(len(a)):
        row = 0.0
        for j in range(len(b)):
            row += M[i, j] * b[j]
        total += a[i] * row
    return total


@compiled
def multiply_vector(A: Floats, x: Floats) -> Floats:
    """Return A x (n,) of A (n, m) and x (m,)."""
    out = np.empty(A.shape[0])
    for i in range(A.shape[0]):
        total = 0.0
        for j in range(A.shape[1]):
            total += A[i, j] * x[j]
        out[i] = total
    return out


@compiled
def multiply_matrices(A: Floats, B: Floats) -> Floats:
    """Return A B (n, k) of A (n, m) and B (m, k)."""
    out = np.empty((A.shape[0], B.shape[1]))
    multiply_into(A, B, out)
    return out


@compiled
def multiply_into(A: Floats, B: Floats, out: Floats) -> None:
    """Write A B of A (n, m) and B (m, k) into `out` (n, k)."""
    for i in range(A.shape[0]):
        for k in range(B.shape[1]):
            total = 0.0
            for j in range(A.shape[1]):
                total += A[i, j] * B[j, k]
            out[i, k] = total


@compiled
def cross(a: Floats, b: Floats) -> Floats:
    """Return a × b (3,)."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
