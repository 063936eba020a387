"""Recursive least squares is the batch fit of all displacements, weighted by their age."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.errors import BadInput
from rcmservo.estimation.displacement import apply_rank_one_update
from rcmservo.estimation.rls import MAX_VARIANCE_PER_MM2, RlsEstimator, inflate_covariance

forgettings = st.floats(0.5, 1.0)


def displacements(seed, count, noise=0.0, size=5.0):
    random = make_random(seed)
    J = random.uniform(-5, 5, (3, 3))
    displacements_p = size * random.standard_normal((count, 3))
    return J, displacements_p, displacements_p @ J.T + noise * random.standard_normal((count, 3))


def estimate_after(estimator, displacements_p, flows):
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for displacement, flow in zip(displacements_p, flows, strict=True):
        J_hat, P = estimator.update_jacobian(J_hat, P, displacement, flow)
    return J_hat, P


def batch(estimator, displacements_p, flows):
    """Return the weighted fit by NumPy, and the inverse of its normal equations."""
    n, root = len(displacements_p), np.sqrt(estimator.forgetting)
    weights = np.append(root ** np.arange(n - 1, -1, -1), np.full(3, root**n))[:, None]
    rows = np.concatenate([displacements_p, np.eye(3) / np.sqrt(estimator.covariance)])
    A, b = weights * rows, weights * np.concatenate([flows, np.zeros((3, 3))])
    return np.linalg.lstsq(A, b, rcond=None)[0].T, np.linalg.inv(A.T @ A)


@given(seeds, st.integers(1, 30), forgettings, st.floats(0.01, 1e4))
def test_it_is_the_weighted_batch_fit(seed, count, forgetting, covariance):
    estimator = RlsEstimator(forgetting=forgetting, covariance=covariance)
    _, displacements_p, flows = displacements(seed, count, noise=1.0)
    J_hat, P = estimate_after(estimator, displacements_p, flows)
    J, inverse = batch(estimator, displacements_p, flows)
    assert np.allclose(J_hat, J, rtol=1e-6, atol=1e-6 * np.abs(J).max())
    assert np.allclose(P, inverse, rtol=1e-6, atol=1e-6 * np.abs(inverse).max())


@given(seeds, st.integers(5, 40))
def test_without_forgetting_the_order_of_displacements_does_not_matter(seed, count):
    estimator = RlsEstimator(forgetting=1.0)
    _, displacements_p, flows = displacements(seed, count, noise=1.0)
    reversed_order = estimate_after(estimator, displacements_p[::-1], flows[::-1])
    for one, other in zip(
        estimate_after(estimator, displacements_p, flows), reversed_order, strict=True
    ):
        assert np.allclose(one, other, atol=1e-7)


@given(seeds)
def test_the_latest_displacement_counts_most(seed):
    """After two Jacobians in turn, forgetting brings Ĵ nearer to the second."""
    first, displacements_p, flows = displacements(seed, 20)
    second = first + make_random(seed + 1).uniform(-5, 5, (3, 3))
    both = np.concatenate([flows, displacements_p @ second.T])
    unforgotten, forgotten = (
        np.linalg.norm(
            estimate_after(
                RlsEstimator(forgetting=forgetting_factor), np.tile(displacements_p, (2, 1)), both
            )[0]
            - second
        )
        for forgetting_factor in (1.0, 0.8)
    )
    assert forgotten < 0.2 * unforgotten


def test_it_averages_noise_that_broydens_update_takes_in():
    errors = []
    for seed in range(30):
        J, displacements_p, flows = displacements(seed, 60, noise=1.0, size=2.0)
        J_broyden = np.zeros((3, 3))
        for displacement, flow in zip(displacements_p, flows, strict=True):
            J_broyden = apply_rank_one_update(J_broyden, displacement, flow, 1.0)
        J_hat = estimate_after(RlsEstimator(), displacements_p, flows)[0]
        errors.append([np.linalg.norm(J_hat - J), np.linalg.norm(J_broyden - J)])
    rls_error, broyden_error = np.median(errors, axis=0)
    assert rls_error < 0.5 * broyden_error


def test_forgetting_stops_at_the_largest_variance():
    P = inflate_covariance(np.diag([1.0, 0.5 * MAX_VARIANCE_PER_MM2, MAX_VARIANCE_PER_MM2]), 0.1)
    assert P.max() == MAX_VARIANCE_PER_MM2
    assert np.array_equal(inflate_covariance(np.eye(3), 0.5), 2.0 * np.eye(3))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (
            {"forgetting": 0.0},
            "estimator.forgetting must be a fraction above 0 and at most 1, got 0",
        ),
        ({"forgetting": 1.01}, "estimator.forgetting must be a fraction"),
        ({"forgetting": np.nan}, "estimator.forgetting must be a fraction"),
        ({"covariance": 0.0}, "estimator.covariance must be a number from 1e-9 to 1e9 1/mm²"),
        ({"covariance": np.inf}, "estimator.covariance must be a number"),
        ({"covariance": np.nan}, "estimator.covariance must be a number"),
    ],
)
def test_settings_outside_their_range_are_refused_in_one_sentence(settings, sentence):
    with pytest.raises(BadInput, match=sentence) as refused:
        RlsEstimator(**settings)
    assert len(str(refused.value).splitlines()) == 1
