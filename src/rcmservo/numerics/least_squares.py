"""Nonlinear least squares with few unknowns: solution, derivative and covariance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.numerics.structs import Floats

RELATIVE_STEP = float(np.sqrt(np.finfo(float).eps))
"""Step of a forward difference, relative to the unknown or to 1, whichever is larger."""
MAX_STEPS = 40
"""Largest number of steps of a fit."""
MIN_RELATIVE_GAIN = 1e-5
"""Relative decrease of the squared residuals below which a fit ends."""


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Solution of a nonlinear least-squares problem.

    Parameters
    ----------
    x : Floats
        Solution (n,).
    covariance : Floats
        Covariance (n, n) of `x`, for residuals in standard deviations.
    misfit : float
        Sum of the squared residuals.
    """

    x: Floats
    covariance: Floats
    misfit: float


def differentiate(residuals: Callable[[Floats], Floats], x: Floats) -> tuple[Floats, Floats]:
    """Return the residuals (r,) at `x` (n,) and their derivative (r, n) by forward differences.

    `residuals` is that of `fit_residuals`.
    """
    shifted = x + RELATIVE_STEP * np.maximum(1.0, np.abs(x)) * np.where(x < 0.0, -1.0, 1.0)
    base, *shifted_residuals = residuals(np.vstack([x, np.where(np.eye(len(x)), shifted, x)]))
    return base, (np.array(shifted_residuals) - base).T / (shifted - x)


def fit_residuals(residuals: Callable[[Floats], Floats], x: Floats) -> LeastSquaresFit:
    """Minimise the sum of squared residuals by a trust-region method.

    Parameters
    ----------
    residuals
        Maps m vectors of unknowns (m, n) to m vectors of residuals (m, r), so that all forward
        differences take one call.
    x
        Initial unknowns (n,).
    """
    from scipy import optimize  # local because the import takes 0.1 s

    @lru_cache(maxsize=1)
    def evaluate(unknowns: tuple[float, ...]) -> tuple[Floats, Floats]:
        """Return the residuals (r,) and their derivative (r, n)."""
        return differentiate(residuals, np.array(unknowns))

    def residual(x: Floats) -> Floats:
        return evaluate(tuple(x))[0]

    def jacobian(x: Floats) -> Floats:
        return evaluate(tuple(x))[1]

    least_squares = cast(Any, optimize).least_squares
    fit: Any = least_squares(residual, x, jacobian, ftol=MIN_RELATIVE_GAIN, max_nfev=MAX_STEPS)
    J: Floats = fit.jac
    covariance = np.asarray(np.linalg.pinv(J.T @ J), np.float64)
    return LeastSquaresFit(fit.x, covariance, 2.0 * float(fit.cost))


def compute_jackknife_covariance(
    residuals: Floats, jacobian: Floats, groups: Sequence[NDArray[np.intp]]
) -> Floats:
    """Return the covariance (n, n) of a fit from its changes if groups of rows are left out.

    The rows after those of all groups are the prior, whose mean is wrong by its own deviation.
    """
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    changes = np.zeros_like(inverse)
    for group in groups:
        rows = group.ravel()
        J, r = jacobian[rows], residuals[rows]
        change = inverse @ J.T @ np.linalg.solve(np.eye(len(rows)) - J @ inverse @ J.T, r)
        changes += np.outer(change, change)
    return (1.0 - 1.0 / len(groups)) * changes + inverse @ inverse
