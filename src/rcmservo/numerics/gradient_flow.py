"""Exact integration of the linear gradient flow dâ/dt = −C Cᵀ (A â − b) over any time.

It is the steepest descent of ½ âᵀAâ − bᵀâ, scaled by C. With H = Cᵀ A C = Q Λ Qᵀ,

    â(t) = â(0) − C Q diag((1 − e^{−λt})/λ) Qᵀ Cᵀ (A â(0) − b).

Where H t is small, as from frame to frame, the matrix Q diag(…) Qᵀ is summed as the series
t − H t²/2 + H² t³/6 − …. About a dozen products give it to the last digit, at a third of the cost
of the eigenvectors.
"""

import numpy as np

from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import (
    compute_norm,
    find_max_abs,
    multiply_matrices,
    multiply_vector,
    subtract,
)
from rcmservo.numerics.structs import Floats

MAX_SERIES_NORM = 4.0
"""Largest Frobenius norm of H t that is summed as a series; the sum loses one digit at most."""

MIN_EIGENVALUE_RATIO = 1e-14
"""Smallest eigenvalue, relative to the Frobenius norm of H, of a mode that was observed. In a mode
with a smaller eigenvalue A â − b is only rounding, so its change does not grow beyond the time at
which the series ends."""


@compiled
def integrate_gradient_flow(A: Floats, b: Floats, a: Floats, C: Floats, t: float) -> Floats:
    """Return â (n,) after the time t, from a (n,), with A (n, n), b (n,) and C (n, n)."""
    H = multiply_matrices(C.T, multiply_matrices(A, C))
    residual = multiply_vector(C.T, subtract(multiply_vector(A, a), b))
    if t * compute_norm(H) < MAX_SERIES_NORM:
        change = integrate_by_series(H, residual, t)
    else:
        change = integrate_by_eigenvectors(H, residual, t)
    return subtract(a, multiply_vector(C, change))


@compiled
def integrate_by_series(H: Floats, residual: Floats, t: float) -> Floats:
    """Return ∫₀ᵗ e^{−Hs} ds `residual` (n,), by its Taylor series."""
    term, total, power = np.empty(len(residual)), np.empty(len(residual)), 1
    for i in range(len(residual)):
        term[i] = total[i] = t * residual[i]
    while find_max_abs(term) > 1e-17 * find_max_abs(total):
        term, power = multiply_vector(H, term), power + 1
        for i in range(len(residual)):
            term[i] *= -t / power
            total[i] += term[i]
    return total


@compiled
def integrate_by_eigenvectors(H: Floats, residual: Floats, t: float) -> Floats:
    """Return ∫₀ᵗ e^{−Hs} ds `residual` (n,), by the eigenvectors of H."""
    eigenvalues, Q = np.linalg.eigh(H)
    modes, norm = multiply_vector(Q.T, residual), compute_norm(H)
    for i in range(len(residual)):
        rate = max(eigenvalues[i], 0.0)
        if rate < MIN_EIGENVALUE_RATIO * norm:
            modes[i] *= min(t, MAX_SERIES_NORM / norm)
        else:
            modes[i] *= -np.expm1(-rate * t) / rate if rate * t > 1e-12 else t
    return multiply_vector(Q, modes)
