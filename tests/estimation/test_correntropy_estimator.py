"""Maximum correntropy: outliers that throw Kalman's filter off hardly move Ĵ, and without outliers
the two are alike.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.errors import BadInput
from rcmservo.estimation.correntropy import MIN_WEIGHT, CorrentropyEstimator, correntropy_weight
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.geometry.features import SCALE


def error(J_hat, J):
    return np.linalg.norm((J_hat - J) / SCALE[:, None]) / np.linalg.norm(J / SCALE[:, None])


def course(estimator, seed, outliers, count=60):
    """Error of Ĵ after each displacement, of which a share are outliers of some 30 px."""
    random = random_from(seed)
    J = random.uniform(-0.5, 0.5, (3, 3)) * SCALE[:, None]
    J_hat, P, errors = np.zeros((3, 3)), estimator.initial_covariance(), []
    for k in range(count):
        way = 4.0 * random.standard_normal(3)
        flow = J @ way + 0.05 * SCALE * random.standard_normal(3)
        off = 3.0 * SCALE * random.standard_normal(3)
        if random.random() < outliers and k >= 10:
            flow = flow + off
        J_hat, P = estimator.update_jacobian(J_hat, P, way, flow)
        errors.append(error(J_hat, J))
    return np.array(errors)


def median_errors(outliers):
    """Over 40 courses, of the last displacements: robust, and not."""
    return [
        np.median([course(one, seed, outliers)[20:].mean() for seed in range(40)])
        for one in (CorrentropyEstimator(), KalmanEstimator())
    ]


@pytest.mark.parametrize(
    ("outliers", "times", "near"), [(0.05, 3.0, 0.05), (0.2, 5.0, 0.15), (0.4, 4.0, 0.25)]
)
def test_with_outliers_it_is_several_times_as_near_as_kalmans_filter(outliers, times, near):
    robust, plain = median_errors(outliers)
    assert times * robust < plain
    assert robust < near


def test_without_outliers_it_is_as_near():
    robust, plain = median_errors(0.0)
    assert robust < 1.05 * plain


def test_one_outlier_moves_it_by_less_than_a_hundredth_of_what_it_moves_kalmans_filter():
    moved = []
    for estimator in (CorrentropyEstimator(), KalmanEstimator()):
        random = random_from(1)
        J = random.uniform(-0.5, 0.5, (3, 3)) * SCALE[:, None]
        J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
        for way in 4.0 * random.standard_normal((15, 3)):
            J_hat, P = estimator.update_jacobian(J_hat, P, way, J @ way)
        way = 4.0 * random.standard_normal(3)
        after, _ = estimator.update_jacobian(J_hat, P, way, J @ way + 5.0 * SCALE)
        moved.append(error(after, J_hat))
    assert moved[0] < 0.01 * moved[1]
    assert moved[1] > 0.1


@given(seeds, st.integers(1, 20))
def test_with_a_wide_kernel_it_is_kalmans_filter(seed, count):
    random = random_from(seed)
    wide, plain = CorrentropyEstimator(bandwidth=1e6), KalmanEstimator()
    J_hat, P, J_plain, P_plain = (
        np.zeros((3, 3)),
        wide.initial_covariance(),
        np.zeros((3, 3)),
        np.eye(3),
    )
    for _ in range(count):
        way, flow = 4.0 * random.standard_normal(3), SCALE * random.standard_normal(3)
        J_hat, P = wide.update_jacobian(J_hat, P, way, flow)
        J_plain, P_plain = plain.update_jacobian(J_plain, P_plain, way, flow)
    assert np.allclose(J_hat / SCALE[:, None], J_plain / SCALE[:, None], atol=1e-6)
    assert np.allclose(P, P_plain, atol=1e-8)


@given(seeds, st.floats(-20.0, 20.0), st.floats(0.5, 10.0))
def test_a_weight_is_the_kernel_of_what_is_new_in_its_own_sigma(seed, off, bandwidth):
    half, way, R = random_from(seed).standard_normal((3, 3)), np.array([1.0, -2.0, 3.0]), 0.5
    P = half @ half.T
    new = off * np.sqrt(way @ P @ way + R)
    wanted = max(np.exp(-0.5 * (off / bandwidth) ** 2), MIN_WEIGHT)
    assert correntropy_weight(P, way, new, R, bandwidth) == pytest.approx(wanted, rel=1e-9)


@given(seeds)
def test_no_news_moves_it_further_than_kalmans_filter(seed):
    random = random_from(seed)
    J_hat, half = random.uniform(-5, 5, (3, 3)), random.standard_normal((3, 3))
    way, flow, P = 4.0 * random.standard_normal(3), 100.0 * random.standard_normal(3), half @ half.T
    robust, _ = CorrentropyEstimator().update_jacobian(J_hat, np.array([P] * 3), way, flow)
    plain, _ = KalmanEstimator().update_jacobian(J_hat, P, way, flow)
    assert np.all(np.abs(robust - J_hat) <= np.abs(plain - J_hat) + 1e-12)


def test_an_empty_estimate_learns_from_its_first_displacements():
    """Their flow is tens of σ from zero, and no outlier."""
    errors = [course(CorrentropyEstimator(), seed, 0.0, count=9)[-1] for seed in range(40)]
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5


@given(seeds)
def test_each_row_has_a_covariance_of_its_own(seed):
    random, wide = random_from(seed), CorrentropyEstimator(bandwidth=1e6)
    P, way = np.stack([size * np.eye(3) for size in (0.01, 0.1, 1.0)]), random.standard_normal(3)
    J_hat, flow = random.uniform(-5, 5, (3, 3)), SCALE * random.standard_normal(3)
    after, P_after = wide.update_jacobian(J_hat, P, way, flow)
    for i in range(3):
        J_plain, P_plain = KalmanEstimator().update_jacobian(J_hat, P[i], way, flow)
        assert np.allclose(after[i], J_plain[i])
        assert np.allclose(P_after[i], P_plain)


def test_only_the_row_that_is_off_is_doubted():
    estimator, way = CorrentropyEstimator(), np.array([3.0, 0.0, 0.0])
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for _ in range(5):
        J_hat, P = estimator.update_jacobian(J_hat, P, way, SCALE)
    J_after, P_after = estimator.update_jacobian(J_hat, P, way, SCALE * np.array([1.0, 6.0, 1.0]))
    assert abs(J_after[1, 0] - J_hat[1, 0]) < 0.01 * J_hat[1, 0]
    assert P_after[1, 0, 0] > 1.2 * P_after[0, 0, 0]


def test_a_camera_that_has_rolled_is_learnt_anew_in_time():
    """At first all that is seen is an outlier; the drift lets it doubt itself."""
    random, estimator = random_from(1), CorrentropyEstimator()
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for J, count in ((np.eye(3), 20), (np.eye(3)[[1, 2, 0]], 300)):
        J_now = 0.4 * J * SCALE[:, None]
        for way in 4.0 * random.standard_normal((count, 3)):
            J_hat, P = estimator.update_jacobian(J_hat, P, way, J_now @ way)
    assert error(J_hat, J_now) < 0.1


@pytest.mark.parametrize("bandwidth", [0.0, 0.05, -1.0, np.nan, np.inf])
def test_a_kernel_that_has_no_width_is_one_sentence(bandwidth):
    sentence = r"estimator.bandwidth must be a number of σ from 0\.1 to 1e6, got"
    with pytest.raises(BadInput, match=sentence) as refused:
        CorrentropyEstimator(bandwidth=bandwidth)
    assert len(str(refused.value).splitlines()) == 1


def test_its_other_settings_are_kalmans():
    with pytest.raises(BadInput, match=r"estimator.noise must be a number"):
        CorrentropyEstimator(noise=0.0)
