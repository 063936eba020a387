"""Inverses and solutions of small systems equal LAPACK's; singular matrices are reported."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.numerics.small_solvers import invert, solve_2x2, solve_3x3

seeds = st.integers(0, 9999)


def matrix_with(seed, eigenvalues):
    """Return a symmetric matrix with these eigenvalues."""
    rng, n = np.random.default_rng(seed), len(eigenvalues)
    V = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return V @ np.diag(eigenvalues) @ V.T


@given(seeds, st.integers(1, 11), st.floats(1.0, 1e6))
def test_positive_definite_matrices_are_inverted_and_others_reported(seed, n, ratio):
    eigenvalues = np.geomspace(1.0, ratio, n)
    M = matrix_with(seed, eigenvalues)
    X = M.copy()
    assert invert(X)
    np.testing.assert_allclose(X, np.linalg.inv(M), atol=1e-9 * ratio)
    eigenvalues[-1] *= -1.0
    assert not invert(matrix_with(seed, eigenvalues))
    assert not invert(np.full((n, n), np.nan)) and not invert(np.zeros((n, n)))


@given(seeds, st.floats(1.0, 1e10))
def test_two_unknowns_are_as_accurate_as_the_condition_allows(seed, ratio):
    N = matrix_with(seed, np.array([1.0, ratio]))
    x = np.random.default_rng(seed).uniform(-1.0, 1.0, 2)
    np.testing.assert_allclose(solve_2x2(N, N @ x), x, atol=1e-15 * 8.0 * ratio)


@given(st.integers(0, 9999), st.floats(1.0, 1e3), st.floats(0.0, 1.0), st.floats(1e-3, 1e3))
def test_solution_and_condition_by_minors_equal_those_of_lapack(seed, condition, middle, size):
    """The condition is NaN where two singular values are nearly equal."""
    rng = np.random.default_rng(seed)
    U, V = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
    A = size * U * np.array([1.0, condition**-middle, 1.0 / condition]) @ V
    found, expected = solve_3x3(A, np.zeros(3))[1], np.linalg.inv(A)
    X = np.stack([solve_3x3(A, column)[0] for column in np.eye(3)], axis=1)
    np.testing.assert_allclose(X, expected, atol=1e-10 * np.abs(expected).max())
    assert np.isnan(found) or abs(found / np.linalg.cond(A) - 1.0) < 1e-9


def test_the_condition_by_minors_is_nan_where_two_singular_values_are_equal():
    assert np.isnan(solve_3x3(np.diag([2.0, 2.0, 1.0]), np.ones(3))[1])
    assert np.isnan(solve_3x3(np.zeros((3, 3)), np.ones(3))[1])
