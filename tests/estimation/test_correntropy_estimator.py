"""Maximum correntropy: outliers hardly change Ĵ; without outliers it is as good as Kalman's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.errors import BadInput
from rcmservo.estimation.correntropy import (
    MIN_WEIGHT,
    CorrentropyEstimator,
    compute_correntropy_weight,
)
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.geometry.features import FEATURE_SCALE


def error(J_hat, J):
    return np.linalg.norm((J_hat - J) / FEATURE_SCALE[:, None]) / np.linalg.norm(
        J / FEATURE_SCALE[:, None]
    )


def error_history(estimator, seed, outliers, count=60):
    """Return the error of Ĵ after each displacement.

    The fraction `outliers` of the displacements has an error of about 30 px.
    """
    random = make_random(seed)
    J = random.uniform(-0.5, 0.5, (3, 3)) * FEATURE_SCALE[:, None]
    J_hat, P, errors = np.zeros((3, 3)), estimator.initial_covariance(), []
    for k in range(count):
        displacement = 4.0 * random.standard_normal(3)
        flow = J @ displacement + 0.05 * FEATURE_SCALE * random.standard_normal(3)
        outlier = 3.0 * FEATURE_SCALE * random.standard_normal(3)
        if random.random() < outliers and k >= 10:
            flow = flow + outlier
        J_hat, P = estimator.update_jacobian(J_hat, P, displacement, flow)
        errors.append(error(J_hat, J))
    return np.array(errors)


def median_errors(outliers):
    """Return the median errors of the robust and the plain filter over 40 histories."""
    return [
        np.median([error_history(one, seed, outliers)[20:].mean() for seed in range(40)])
        for one in (CorrentropyEstimator(), KalmanEstimator())
    ]


@pytest.mark.parametrize(
    ("outliers", "ratio", "bound"), [(0.05, 3.0, 0.05), (0.2, 5.0, 0.15), (0.4, 4.0, 0.25)]
)
def test_with_outliers_its_error_is_a_fraction_of_the_kalman_filters(outliers, ratio, bound):
    robust, kalman = median_errors(outliers)
    assert ratio * robust < kalman
    assert robust < bound


def test_without_outliers_it_is_as_accurate():
    robust, kalman = median_errors(0.0)
    assert robust < 1.05 * kalman


def test_one_outlier_changes_it_by_less_than_a_hundredth_of_the_kalman_filter():
    changes = []
    for estimator in (CorrentropyEstimator(), KalmanEstimator()):
        random = make_random(1)
        J = random.uniform(-0.5, 0.5, (3, 3)) * FEATURE_SCALE[:, None]
        J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
        for displacement in 4.0 * random.standard_normal((15, 3)):
            J_hat, P = estimator.update_jacobian(J_hat, P, displacement, J @ displacement)
        displacement = 4.0 * random.standard_normal(3)
        after, _ = estimator.update_jacobian(
            J_hat, P, displacement, J @ displacement + 5.0 * FEATURE_SCALE
        )
        changes.append(error(after, J_hat))
    assert changes[0] < 0.01 * changes[1]
    assert changes[1] > 0.1


@given(seeds, st.integers(1, 20))
def test_with_a_wide_kernel_it_is_the_kalman_filter(seed, count):
    random = make_random(seed)
    wide, kalman = CorrentropyEstimator(bandwidth=1e6), KalmanEstimator(noise=0.1)
    J_hat, P, J_plain, P_plain = (
        np.zeros((3, 3)),
        wide.initial_covariance(),
        np.zeros((3, 3)),
        np.eye(3),
    )
    for _ in range(count):
        displacement, flow = (
            4.0 * random.standard_normal(3),
            FEATURE_SCALE * random.standard_normal(3),
        )
        J_hat, P = wide.update_jacobian(J_hat, P, displacement, flow)
        J_plain, P_plain = kalman.update_jacobian(J_plain, P_plain, displacement, flow)
    assert np.allclose(J_hat / FEATURE_SCALE[:, None], J_plain / FEATURE_SCALE[:, None], atol=1e-6)
    assert np.allclose(P, P_plain, atol=1e-8)


@given(st.floats(-20.0, 20.0), st.floats(0.5, 10.0))
def test_a_weight_is_the_kernel_of_the_innovation(innovation, bandwidth):
    expected = max(np.exp(-0.5 * (innovation / bandwidth) ** 2), MIN_WEIGHT)
    assert compute_correntropy_weight(innovation, bandwidth) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("outliers", "share"), [(0.05, 0.95), (0.1, 0.87)])
def test_outliers_from_the_first_displacement_on_do_not_lock_it_in(outliers, share):
    """Their two wrong displacements each leave no estimate to which the right ones are outliers."""
    learned = [learn_with_wrong_frames(CorrentropyEstimator(), s, outliers) for s in range(100)]
    plain = [learn_with_wrong_frames(KalmanEstimator(), s, outliers) for s in range(100)]
    assert np.mean(np.array(learned) < 0.3) >= share > 2.0 * np.mean(np.array(plain) < 0.3)


def learn_with_wrong_frames(estimator, seed, outliers):
    """Return the error of Ĵ after 80 displacements; each wrong frame spoils two of them."""
    random = make_random(seed)
    J = random.uniform(-0.5, 0.5, (3, 3)) * FEATURE_SCALE[:, None]
    J_hat, P, frame_error = np.zeros((3, 3)), estimator.initial_covariance(), np.zeros(3)
    for _ in range(80):
        displacement, before = random.standard_normal(3), frame_error
        is_wrong, wrong = random.random() < outliers, random.uniform(3.0, 10.0, 3)
        frame_error = FEATURE_SCALE * (0.03 * random.standard_normal(3) + is_wrong * wrong)
        flow = J @ displacement + frame_error - before
        J_hat, P = estimator.update_jacobian(J_hat, P, displacement, flow)
    return error(J_hat, J)


@given(seeds)
def test_no_innovation_changes_it_more_than_the_kalman_filter(seed):
    random = make_random(seed)
    J_hat, half = random.uniform(-5, 5, (3, 3)), random.standard_normal((3, 3))
    displacement, flow, P = (
        4.0 * random.standard_normal(3),
        100.0 * random.standard_normal(3),
        half @ half.T,
    )
    robust, _ = CorrentropyEstimator().update_jacobian(J_hat, np.array([P] * 3), displacement, flow)
    kalman, _ = KalmanEstimator(noise=0.1).update_jacobian(J_hat, P, displacement, flow)
    assert np.all(np.abs(robust - J_hat) <= np.abs(kalman - J_hat) + 1e-12)


def test_an_empty_estimate_adapts_to_its_first_displacements():
    """Their flow is tens of σ from zero, and yet no outlier."""
    errors = [error_history(CorrentropyEstimator(), seed, 0.0, count=9)[-1] for seed in range(40)]
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5


@given(seeds)
def test_each_row_has_a_covariance_of_its_own(seed):
    random, wide = make_random(seed), CorrentropyEstimator(bandwidth=1e6)
    P, displacement = (
        np.stack([size * np.eye(3) for size in (0.01, 0.1, 1.0)]),
        random.standard_normal(3),
    )
    J_hat, flow = random.uniform(-5, 5, (3, 3)), FEATURE_SCALE * random.standard_normal(3)
    after, P_after = wide.update_jacobian(J_hat, P, displacement, flow)
    for i in range(3):
        J_plain, P_plain = KalmanEstimator(noise=0.1).update_jacobian(
            J_hat, P[i], displacement, flow
        )
        assert np.allclose(after[i], J_plain[i])
        assert np.allclose(P_after[i], P_plain)


def test_only_the_row_with_an_outlier_is_suppressed():
    estimator, displacement = CorrentropyEstimator(), np.array([3.0, 0.0, 0.0])
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for _ in range(5):
        J_hat, P = estimator.update_jacobian(J_hat, P, displacement, FEATURE_SCALE)
    J_after, P_after = estimator.update_jacobian(
        J_hat, P, displacement, FEATURE_SCALE * np.array([1.0, 6.0, 1.0])
    )
    assert abs(J_after[1, 0] - J_hat[1, 0]) < 0.01 * J_hat[1, 0]
    assert P_after[1, 0, 0] > 1.2 * P_after[0, 0, 0]


def test_it_adapts_to_a_rolled_camera():
    """At first every innovation is an outlier; the drift then raises the covariance."""
    random, estimator = make_random(1), CorrentropyEstimator()
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for J, count in ((np.eye(3), 20), (np.eye(3)[[1, 2, 0]], 300)):
        J_now = 0.4 * J * FEATURE_SCALE[:, None]
        for displacement in 4.0 * random.standard_normal((count, 3)):
            J_hat, P = estimator.update_jacobian(J_hat, P, displacement, J_now @ displacement)
    assert error(J_hat, J_now) < 0.1


@pytest.mark.parametrize("bandwidth", [0.0, 0.05, -1.0, np.nan, np.inf])
def test_a_kernel_without_width_is_refused_in_one_sentence(bandwidth):
    sentence = r"estimator.bandwidth must be a kernel width in b from 0\.1 to 1e6, got"
    with pytest.raises(BadInput, match=sentence) as refused:
        CorrentropyEstimator(bandwidth=bandwidth)
    assert len(str(refused.value).splitlines()) == 1


def test_its_other_settings_are_those_of_the_kalman_filter():
    with pytest.raises(BadInput, match=r"estimator.noise must be a number"):
        CorrentropyEstimator(noise=0.0)
