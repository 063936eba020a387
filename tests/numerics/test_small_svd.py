"""Singular values by rotations equal LAPACK's, down to the smallest."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rcmservo.numerics.small_svd import compute_condition, orthogonalise_in_place

shapes = st.sampled_from([(3, 3), (4, 3), (6, 3), (2, 2)])


def matrix(seed, shape, condition):
    rng = np.random.default_rng(seed)
    U, _, Vt = np.linalg.svd(rng.normal(size=shape), full_matrices=False)
    return U * np.geomspace(1.0, 1.0 / condition, shape[1]) @ Vt


def orthogonalise_columns(A):
    """Return B = A V with orthogonal columns, and the rotation V."""
    B, V = A.copy(), np.empty((A.shape[1], A.shape[1]))
    orthogonalise_in_place(B, V)
    return B, V


@given(st.integers(0, 9999), shapes, st.floats(1.0, 1e6), st.floats(1e-6, 1e6))
def test_the_columns_are_orthogonal_and_their_lengths_are_the_singular_values(
    seed, shape, condition, size
):
    A = size * matrix(seed, shape, condition)
    B, V = orthogonalise_columns(A)
    lengths = np.linalg.norm(B, axis=0)
    n = shape[1]
    np.testing.assert_allclose(V.T @ V, np.eye(n), atol=1e-14)
    np.testing.assert_allclose(B, A @ V, atol=1e-13 * size)
    np.testing.assert_allclose((B / lengths).T @ (B / lengths), np.eye(n), atol=1e-13)
    singular_values = np.sort(lengths)[::-1]
    np.testing.assert_allclose(
        singular_values, np.linalg.svd(A, compute_uv=False), atol=1e-14 * size
    )


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(1e-12, 1e-3))
def test_small_singular_values_keep_their_digits(x, y, z, small):
    """Columns of very unequal length keep the digits that LAPACK rounds off."""
    A = np.array([[1.0, 0.0, x], [0.0, 1.0, y], [z, 0.0, 1.0]]) @ np.diag([1.0, small, 1.0])
    lengths = np.linalg.norm(orthogonalise_columns(A)[0], axis=0)
    determinant = np.linalg.det(A)
    np.testing.assert_allclose(np.prod(lengths), abs(determinant), rtol=1e-9, atol=1e-12 * small)


def test_zero_stays_zero_and_overflow_or_nan_terminates():
    assert not orthogonalise_columns(np.zeros((3, 3)))[0].any()
    orthogonalise_columns(np.full((3, 3), 1e200))
    orthogonalise_columns(np.full((3, 3), np.nan))


@given(st.integers(0, 9999), shapes, st.floats(1.0, 1e6))
def test_the_condition_is_the_largest_over_the_smallest_singular_value(seed, shape, known):
    assert np.isclose(compute_condition(matrix(seed, shape, known)), known, rtol=1e-9)


def test_singular_or_not_finite_matrices_have_an_infinite_condition():
    for number in (0.0, np.nan, np.inf):
        assert compute_condition(np.diag([1.0, 1.0, number])) == np.inf
