"""Singular values by rotation are those of LAPACK, down to the smallest."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.numerics.small_svd import condition, right_angled

shapes = st.sampled_from([(3, 3), (4, 3), (6, 3), (2, 2)])


def matrix(seed, shape, condition):
    rng = np.random.default_rng(seed)
    U, _, Vt = np.linalg.svd(rng.normal(size=shape), full_matrices=False)
    return U * np.geomspace(1.0, 1.0 / condition, shape[1]) @ Vt


@given(st.integers(0, 9999), shapes, st.floats(1.0, 1e6), st.floats(1e-6, 1e6))
def test_the_columns_stand_at_right_angles_and_their_lengths_are_the_singular_values(
    seed, shape, condition, size
):
    A = size * matrix(seed, shape, condition)
    B, V = right_angled(A)
    lengths = np.linalg.norm(B, axis=0)
    n = shape[1]
    np.testing.assert_allclose(V.T @ V, np.eye(n), atol=1e-14)
    np.testing.assert_allclose(B, A @ V, atol=1e-13 * size)
    np.testing.assert_allclose((B / lengths).T @ (B / lengths), np.eye(n), atol=1e-13)
    found = np.sort(lengths)[::-1]
    np.testing.assert_allclose(found, np.linalg.svd(A, compute_uv=False), atol=1e-14 * size)


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(1e-12, 1e-3))
def test_small_singular_values_keep_their_digits(x, y, z, small):
    """Columns of very unequal length: what LAPACK rounds away is still there."""
    A = np.array([[1.0, 0.0, x], [0.0, 1.0, y], [z, 0.0, 1.0]]) @ np.diag([1.0, small, 1.0])
    lengths = np.linalg.norm(right_angled(A)[0], axis=0)
    determinant = np.linalg.det(A)
    np.testing.assert_allclose(np.prod(lengths), abs(determinant), rtol=1e-9, atol=1e-12 * small)


def test_nothing_stays_nothing_and_what_is_too_large_ends():
    assert not right_angled(np.zeros((3, 3)))[0].any()
    right_angled(np.full((3, 3), 1e200))
    right_angled(np.full((3, 3), np.nan))


@given(st.integers(0, 9999), shapes, st.floats(1.0, 1e6))
def test_the_condition_is_the_largest_of_them_over_the_least(seed, shape, known):
    assert np.isclose(condition(matrix(seed, shape, known)), known, rtol=1e-9)


def test_what_has_no_inverse_or_is_not_finite_has_an_infinite_condition():
    for number in (0.0, np.nan, np.inf):
        assert condition(np.diag([1.0, 1.0, number])) == np.inf
