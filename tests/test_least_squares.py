"""Nonlinear least squares: solution, covariance and misfit."""

import numpy as np

from rcmservo.numerics.least_squares import fit_residuals


def test_the_covariance_of_a_linear_fit_is_that_of_the_normal_equations() -> None:
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(20, 3)), rng.normal(size=20)
    fit = fit_residuals(lambda x: x @ A.T - b, np.zeros(3))
    assert np.allclose(fit.x, np.linalg.lstsq(A, b)[0])
    assert np.allclose(fit.covariance, np.linalg.inv(A.T @ A), rtol=1e-5)
    assert np.isclose(fit.misfit, ((A @ fit.x - b) ** 2).sum())
