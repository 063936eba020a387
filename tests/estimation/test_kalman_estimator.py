"""The Kalman filter on the rows of Ĵ: consistent covariance, drift with the path, limit of RLS."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.errors import BadInput
from rcmservo.estimation.kalman import KalmanEstimator, predict_covariance
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.geometry.features import FEATURE_SCALE

drifts = st.floats(0.0, 0.1)
noises = st.floats(1e-2, 1.0)


def estimate_after(estimator, displacements, flows):
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for displacement, flow in zip(displacements, flows, strict=True):
        J_hat, P = estimator.update_jacobian(J_hat, P, displacement, flow)
    return J_hat, P


def noisy_displacements(random, J, count, size=4.0, noise=0.05):
    """Return displacements and flows with noise in b."""
    displacements = size * random.standard_normal((count, 3))
    return displacements, displacements @ J.T + noise * FEATURE_SCALE * random.standard_normal(
        (count, 3)
    )


@given(seeds, st.integers(1, 40), drifts, noises, st.floats(1e-3, 50.0))
def test_its_covariance_stays_symmetric_and_positive_definite(seed, count, drift, noise, size):
    random, estimator = make_random(seed), KalmanEstimator(drift=drift, noise=noise)
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for _ in range(count):
        displacement = size * random.standard_normal(3)
        J_hat, P = estimator.update_jacobian(J_hat, P, displacement, random.uniform(-50, 50, 3))
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P).min() > 0.0


@given(seeds, st.integers(1, 30), st.floats(0.01, 1.0), st.floats(0.01, 10.0))
def test_without_drift_it_is_recursive_least_squares_that_forgets_nothing(
    seed, count, noise, spread
):
    displacements, flows = noisy_displacements(make_random(seed), np.ones((3, 3)), count)
    kalman = KalmanEstimator(drift=0.0, noise=noise, initial_std=spread)
    rls = RlsEstimator(forgetting=1.0, covariance=(spread / noise) ** 2)
    (J_hat, P), (J_rls, P_rls) = (
        estimate_after(estimator, displacements, flows) for estimator in (kalman, rls)
    )
    assert np.allclose(J_hat, J_rls, rtol=1e-7, atol=1e-7)
    assert np.allclose(P, noise**2 * P_rls, rtol=1e-7, atol=1e-12)


@given(seeds, drifts)
def test_two_half_paths_drift_as_much_as_the_whole_path_and_rest_adds_nothing(seed, drift):
    displacement, P = make_random(seed).standard_normal(3), np.diag([1.0, 2.0, 3.0])
    halves = predict_covariance(
        predict_covariance(P, displacement / 2, drift), displacement / 2, drift
    )
    assert np.allclose(halves, predict_covariance(P, displacement, drift))
    assert np.array_equal(predict_covariance(P, np.zeros(3), drift), P)


def test_its_covariance_is_consistent_for_a_jacobian_with_this_drift():
    """The squared error of a row in units of P is three on average; P is far below its start."""
    estimator, scores = KalmanEstimator(), []
    for seed in range(150):
        random = make_random(seed)
        x = estimator.initial_std * random.standard_normal((3, 3))
        J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
        for displacement in 4.0 * random.standard_normal((25, 3)):
            x += (
                estimator.drift
                * np.sqrt(np.linalg.norm(displacement))
                * random.standard_normal((3, 3))
            )
            flow = FEATURE_SCALE * (x @ displacement + estimator.noise * random.standard_normal(3))
            J_hat, P = estimator.update_jacobian(J_hat, P, displacement, flow)
        error = J_hat / FEATURE_SCALE[:, None] - x
        scores.append(np.einsum("ij,jk,ik->i", error, np.linalg.inv(P), error))
        assert np.trace(P) < 0.01 * np.trace(estimator.initial_covariance())
    assert np.mean(scores) == pytest.approx(3.0, abs=0.35)


def test_noise_in_b_counts_alike_in_every_feature():
    """The gain of every row is the same, as radians and pixels are scaled."""
    estimator = KalmanEstimator()
    J_hat, _ = estimator.update_jacobian(
        np.zeros((3, 3)), estimator.initial_covariance(), np.full(3, 2.0), FEATURE_SCALE
    )
    rows = J_hat / FEATURE_SCALE[:, None]
    assert np.allclose(rows, rows[0])
    assert np.all(rows > 0.0)


def test_it_adapts_to_a_rolled_camera():
    random, estimator = make_random(1), KalmanEstimator()
    before = random.uniform(-0.5, 0.5, (3, 3)) * FEATURE_SCALE[:, None]
    after = random.uniform(-0.5, 0.5, (3, 3)) * FEATURE_SCALE[:, None]
    parts = [noisy_displacements(random, J, n) for J, n in ((before, 20), (after, 150))]
    displacements, flows = (np.concatenate(both) for both in zip(*parts, strict=True))
    J_hat, _ = estimate_after(estimator, displacements, flows)
    assert np.linalg.norm((J_hat - after) / FEATURE_SCALE[:, None]) < 0.1


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"drift": -0.1}, "estimator.drift must be a number from 0 to 1000, got -0.1"),
        ({"drift": np.nan}, "estimator.drift must be a number"),
        ({"noise": 0.0}, "estimator.noise must be a number from 1e-6 to 1000, got 0"),
        ({"noise": np.inf}, "estimator.noise must be a number"),
        ({"initial_std": 0.0}, "estimator.initial_std must be a number"),
        ({"initial_std": np.nan}, "estimator.initial_std must be a number"),
    ],
)
def test_settings_outside_their_range_are_refused_in_one_sentence(settings, sentence):
    with pytest.raises(BadInput, match=sentence) as refused:
        KalmanEstimator(**settings)
    assert len(str(refused.value).splitlines()) == 1
