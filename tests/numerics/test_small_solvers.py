"""Inverses and solutions of small systems are those of LAPACK; a matrix without one is reported."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.numerics.small_solvers import invert, solve_2x2, solve_3x3

seeds = st.integers(0, 9999)


def turned(seed, strengths):
    """A symmetric matrix with these eigenvalues."""
    rng, n = np.random.default_rng(seed), len(strengths)
    V = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return V @ np.diag(strengths) @ V.T


@given(seeds, st.integers(1, 11), st.floats(1.0, 1e6))
def test_the_inverse_is_that_of_a_positive_definite_matrix(seed, n, ratio):
    strengths = np.geomspace(1.0, ratio, n)
    M = turned(seed, strengths)
    X = M.copy()
    assert invert(X)
    np.testing.assert_allclose(X, np.linalg.inv(M), atol=1e-9 * ratio)
    strengths[-1] *= -1.0
    assert not invert(turned(seed, strengths))
    assert not invert(np.full((n, n), np.nan)) and not invert(np.zeros((n, n)))


@given(seeds, st.floats(1.0, 1e10))
def test_two_unknowns_keep_the_digits_that_the_condition_leaves(seed, ratio):
    N = turned(seed, np.array([1.0, ratio]))
    x = np.random.default_rng(seed).uniform(-1.0, 1.0, 2)
    np.testing.assert_allclose(solve_2x2(N, N @ x), x, atol=1e-15 * 8.0 * ratio)


@given(st.integers(0, 9999), st.floats(1.0, 1e3), st.floats(0.0, 1.0), st.floats(1e-3, 1e3))
def test_the_solution_by_minors_and_the_condition_are_those_of_lapack(
    seed, condition, middle, size
):
    """Where two singular values are nearly equal it does not tell the condition."""
    rng = np.random.default_rng(seed)
    U, V = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
    A = size * U * np.array([1.0, condition**-middle, 1.0 / condition]) @ V
    found, wanted = solve_3x3(A, np.zeros(3))[1], np.linalg.inv(A)
    X = np.stack([solve_3x3(A, column)[0] for column in np.eye(3)], axis=1)
    np.testing.assert_allclose(X, wanted, atol=1e-10 * np.abs(wanted).max())
    assert np.isnan(found) or abs(found / np.linalg.cond(A) - 1.0) < 1e-9


def test_the_condition_by_minors_is_not_told_where_two_singular_values_are_equal():
    assert np.isnan(solve_3x3(np.diag([2.0, 2.0, 1.0]), np.ones(3))[1])
    assert np.isnan(solve_3x3(np.zeros((3, 3)), np.ones(3))[1])
