"""Common properties of the estimators that update Ĵ by displacements."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import (
    TOOLS,
    draw_calibration_matrix,
    draw_tool_positions,
    make_random,
    project_markers,
    seeds,
    snapshot,
)
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Sample
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.correntropy import CorrentropyEstimator
from rcmservo.estimation.displacement import (
    compute_kalman_gain,
    correct_jacobian,
    update_covariance,
)
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.kalman import KalmanEstimator
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.estimation.rls import RlsEstimator
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.geometry.projection import extract_parameters

AVERAGING = (RlsEstimator, KalmanEstimator, CorrentropyEstimator, NormalisedFlowEstimator)
ESTIMATORS = (*AVERAGING, BroydenEstimator)
TOOL = TOOLS["rigid"]
every_estimator = pytest.mark.parametrize("kind", ESTIMATORS)


def memory_after(estimator, samples, memory=None):
    memory = estimator.init() if memory is None else memory
    for sample in samples:
        memory = estimator.update(memory, TOOL, sample)
    return memory


def frames(seed, steps, noise=0.0):
    """Return frames with marker 1 at `steps` (n, 3) mm from a first position."""
    random = make_random(seed)
    positions = draw_tool_positions(random, 1)[0] + steps
    C = draw_calibration_matrix(random, positions)
    o_c = extract_parameters(C)[1]
    return [
        Sample(p, project_markers(C, p) + noise * random.standard_normal((2, 2)), o_c, 0.02)
        for p in positions
    ]


@every_estimator
@given(seeds, st.floats(0.1, 10.0), st.floats(0.0, 0.99))
def test_a_tool_at_rest_changes_neither_estimate_nor_covariance(kind, seed, step, fraction):
    """It holds for any motion within min_step and any noise of the markers."""
    estimator, direction = kind(min_step=step), make_random(seed).standard_normal(3)
    moves = np.outer([0.0, 2.0 * step], direction / np.linalg.norm(direction))
    shakes = moves[1] + fraction * step * np.outer(
        np.tile([1.0, -1.0], 10), direction / np.linalg.norm(direction)
    )
    samples = frames(seed, np.concatenate([moves, shakes]), noise=1.0)
    moved_memory = memory_after(estimator, samples[:2])
    assert moved_memory.J_hat.any()
    assert snapshot(memory_after(estimator, samples[2:], moved_memory)) == snapshot(moved_memory)


@every_estimator
def test_small_steps_add_up_to_a_displacement(kind):
    estimator = kind(min_step=1.0)
    memory, updated = estimator.init(), []
    for i, sample in enumerate(frames(3, np.outer(0.3 * np.arange(9), [0.6, 0.0, 0.8]))):
        before, memory = memory, estimator.update(memory, TOOL, sample)
        if not np.array_equal(memory.J_hat, before.J_hat):
            updated.append(i)
    assert updated == [4, 8]


@every_estimator
def test_the_speed_of_a_displacement_does_not_matter(kind):
    slow = frames(5, make_random(5).uniform(-20, 20, (9, 3)))
    fast = [sample._replace(dt=1e-3 * sample.dt) for sample in slow]
    assert snapshot(memory_after(kind(), slow)) == snapshot(memory_after(kind(), fast))


@every_estimator
def test_features_of_both_ends_are_taken_about_the_present_origin(kind):
    points = np.array([[10.0, 20.0], [30.0, 50.0]])
    first = Sample(np.zeros(3), points, np.array([0.0, 0.0]), 0.0)
    second = Sample(np.full(3, 5.0), points, np.array([40.0, -25.0]), 0.02)
    memory = memory_after(kind(), [first, second])
    assert memory.p1 is second.p1
    assert not memory.J_hat.any()


@pytest.mark.parametrize("estimator", [*(kind() for kind in ESTIMATORS), FlowEstimator(gamma=1.0)])
def test_an_angle_that_wraps_counts_as_a_small_rotation(estimator):
    before, after = [[-50.0, 1.0], [-150.0, 2.0]], [[-50.0, -1.0], [-150.0, -2.0]]
    first = Sample(np.zeros(3), np.array(before), np.zeros(2), 0.0)
    second = Sample(np.array([3.0, 0.0, 0.0]), np.array(after), np.zeros(2), 0.02)
    assert 0.0 < abs(memory_after(estimator, [first, second]).J_hat[0, 0]) < 0.1


@every_estimator
@given(seeds)
def test_exact_displacements_converge_to_the_true_jacobian(kind, seed):
    random, estimator = make_random(seed), kind()
    J = random.uniform(-0.5, 0.5, (3, 3)) * FEATURE_SCALE[:, None]
    J_hat, P = np.zeros((3, 3)), estimator.initial_covariance()
    for _ in range(20):
        for direction in np.linalg.qr(random.standard_normal((3, 3)))[0]:
            J_hat, P = estimator.update_jacobian(J_hat, P, 5.0 * direction, J @ (5.0 * direction))
    error = np.linalg.norm((J_hat - J) / FEATURE_SCALE[:, None])
    assert error < 1e-3 * np.linalg.norm(J / FEATURE_SCALE[:, None])


@every_estimator
def test_update_is_pure_and_the_first_frame_changes_no_estimate(kind):
    estimator, (first, second) = kind(), frames(3, np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 0.0]]))
    memory = memory_after(estimator, [first])
    before = snapshot(memory)
    assert not estimator.jacobian(memory, TOOL, first).any()
    after = memory_after(estimator, [second], memory)
    assert estimator.jacobian(after, TOOL, second).any()
    assert snapshot(memory) == before
    assert snapshot(memory_after(estimator, [second], memory)) == snapshot(after)
    assert estimator.predict(memory, TOOL, first.p1) is None


@every_estimator
@given(seeds, st.floats(1e-3, 1e3), st.floats(0.0, 1e6), st.integers(1, 30))
def test_finite_displacements_give_finite_estimates(kind, seed, step, flow, n):
    """The displacements are along one line, or in any direction."""
    random, estimator = make_random(seed), kind()
    line, J_hat, P = random.standard_normal(3), np.zeros((3, 3)), estimator.initial_covariance()
    for k in range(n):
        direction = line if seed % 2 else random.standard_normal(3)
        J_hat, P = estimator.update_jacobian(
            J_hat, P, step * direction, flow * random.standard_normal(3) * (k % 3)
        )
    assert np.isfinite(J_hat).all() and np.isfinite(P).all()


@pytest.mark.parametrize("kind", (RlsEstimator, KalmanEstimator, CorrentropyEstimator))
def test_many_displacements_along_one_line_leave_p_positive_definite(kind):
    """The path is 30 m long, with no measurement in any other direction."""
    estimator, J_hat = kind(), np.zeros((3, 3))
    P = estimator.initial_covariance()
    for _ in range(10_000):
        J_hat, P = estimator.update_jacobian(
            J_hat, P, np.array([3.0, 0.1, 0.0]), np.array([0.01, 9.0, 5.0])
        )
    assert np.isfinite(J_hat).all()
    for block in np.atleast_3d(P).reshape(-1, 3, 3):
        assert np.array_equal(block, block.T)
        assert np.linalg.eigvalsh(block).min() > 0.0


@given(seeds, st.floats(1e-2, 1e2), st.floats(1e-4, 10.0))
def test_the_gain_minimises_the_covariance(seed, step, R):
    random = make_random(seed)
    root, direction = random.standard_normal((3, 3)), step * random.standard_normal(3)
    P = root @ root.T
    K = compute_kalman_gain(P, direction, R)
    best = update_covariance(P, direction, R, K)
    assert np.array_equal(best, best.T)
    assert np.allclose(
        best, P - np.outer(K, P @ direction), atol=1e-9 * (1.0 + step**2) * np.abs(P).max()
    )
    other_covariance = update_covariance(P, direction, R, K + 0.1 * random.standard_normal(3))
    assert np.linalg.eigvalsh(other_covariance).min() > -1e-12 * np.abs(other_covariance).max()
    assert np.trace(other_covariance) >= np.trace(best) * (1.0 - 1e-9)


def test_a_correction_changes_each_row_by_its_own_innovation():
    J, direction, K = (
        np.arange(9.0).reshape(3, 3),
        np.array([1.0, 0.0, 2.0]),
        np.array([0.5, 0.0, 0.25]),
    )
    flow = J @ direction + np.array([1.0, 0.0, -4.0])
    after = correct_jacobian(J, direction, flow, K)
    assert np.allclose(after - J, np.outer([1.0, 0.0, -4.0], K))


@every_estimator
def test_a_displacement_is_at_least_as_long_as_min_step(kind):
    for distance_mm, is_long in ((2.0, True), (1.999, False)):
        samples = frames(3, np.array([[0.0, 0.0, 0.0], [0.0, distance_mm, 0.0]]))
        samples[0] = samples[0]._replace(p1=np.zeros(3))
        samples[1] = samples[1]._replace(p1=np.array([0.0, distance_mm, 0.0]))
        assert memory_after(kind(min_step=2.0), samples).J_hat.any() == is_long


@every_estimator
@pytest.mark.parametrize("min_step", [0.0, -1.0, np.nan, np.inf])
def test_a_step_that_is_no_positive_length_is_refused(kind, min_step):
    with pytest.raises(BadInput, match=r"estimator.min_step must be a positive length in mm, got"):
        kind(min_step=min_step)


def test_averaging_estimators_have_a_smaller_min_step_than_broyden():
    assert {kind().min_step for kind in AVERAGING} == {2.0}
    assert BroydenEstimator().min_step == 3.0
