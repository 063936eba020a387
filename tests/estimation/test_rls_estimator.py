"""Recursive least squares is the batch fit of all displacements, weighted by their age."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.errors import BadInput
from rcmservo.estimation.broyden import learn as broyden_learn
from rcmservo.estimation.rls import MOST, RlsEstimator, aged

forgettings = st.floats(0.5, 1.0)


def displacements(seed, count, noise=0.0, size=5.0):
    random = random_from(seed)
    J = random.uniform(-5, 5, (3, 3))
    ways = size * random.standard_normal((count, 3))
    return J, ways, ways @ J.T + noise * random.standard_normal((count, 3))


def learnt(estimator, ways, flows):
    J_hat, P = np.zeros((3, 3)), estimator.uncertain()
    for way, flow in zip(ways, flows, strict=True):
        J_hat, P = estimator.learn(J_hat, P, way, flow)
    return J_hat, P


def batch(estimator, ways, flows):
    """The weighted fit by NumPy, and the inverse of its normal equations."""
    n, root = len(ways), np.sqrt(estimator.forgetting)
    weights = np.append(root ** np.arange(n - 1, -1, -1), np.full(3, root**n))[:, None]
    rows = np.concatenate([ways, np.eye(3) / np.sqrt(estimator.covariance)])
    A, b = weights * rows, weights * np.concatenate([flows, np.zeros((3, 3))])
    return np.linalg.lstsq(A, b, rcond=None)[0].T, np.linalg.inv(A.T @ A)


@given(seeds, st.integers(1, 30), forgettings, st.floats(0.01, 1e4))
def test_it_is_the_weighted_batch_fit(seed, count, forgetting, covariance):
    estimator = RlsEstimator(forgetting=forgetting, covariance=covariance)
    _, ways, flows = displacements(seed, count, noise=1.0)
    J_hat, P = learnt(estimator, ways, flows)
    J, inverse = batch(estimator, ways, flows)
    assert np.allclose(J_hat, J, rtol=1e-6, atol=1e-6 * np.abs(J).max())
    assert np.allclose(P, inverse, rtol=1e-6, atol=1e-6 * np.abs(inverse).max())


@given(seeds, st.integers(5, 40))
def test_without_forgetting_the_order_of_displacements_does_not_matter(seed, count):
    estimator = RlsEstimator(forgetting=1.0)
    _, ways, flows = displacements(seed, count, noise=1.0)
    turned = learnt(estimator, ways[::-1], flows[::-1])
    for one, other in zip(learnt(estimator, ways, flows), turned, strict=True):
        assert np.allclose(one, other, atol=1e-7)


@given(seeds)
def test_the_latest_displacement_counts_most(seed):
    """Two Jacobians, one after the other: with forgetting Ĵ is nearer to the second."""
    first, ways, flows = displacements(seed, 20)
    second = first + random_from(seed + 1).uniform(-5, 5, (3, 3))
    both = np.concatenate([flows, ways @ second.T])
    kept, forgot = (
        np.linalg.norm(
            learnt(RlsEstimator(forgetting=share), np.tile(ways, (2, 1)), both)[0] - second
        )
        for share in (1.0, 0.8)
    )
    assert forgot < 0.2 * kept


def test_noise_is_averaged_that_broydens_update_learns():
    errors = []
    for seed in range(30):
        J, ways, flows = displacements(seed, 60, noise=1.0, size=2.0)
        J_broyden = np.zeros((3, 3))
        for way, flow in zip(ways, flows, strict=True):
            J_broyden = broyden_learn(J_broyden, way, flow)
        J_hat = learnt(RlsEstimator(), ways, flows)[0]
        errors.append([np.linalg.norm(J_hat - J), np.linalg.norm(J_broyden - J)])
    ours, broydens = np.median(errors, axis=0)
    assert ours < 0.5 * broydens


def test_what_is_forgotten_is_never_more_than_all():
    P = aged(np.diag([1.0, 0.5 * MOST, MOST]), 0.1)
    assert P.max() == MOST
    assert np.array_equal(aged(np.eye(3), 0.5), 2.0 * np.eye(3))


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
def test_settings_that_mean_nothing_are_one_sentence(settings, sentence):
    with pytest.raises(BadInput, match=sentence) as refused:
        RlsEstimator(**settings)
    assert len(str(refused.value).splitlines()) == 1
