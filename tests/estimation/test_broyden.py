"""Broyden's update is the least change that explains a displacement, and small displacements teach
nothing.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import TOOLS, markers_seen, random_from, seeds, tool_positions, true_camera
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Sample
from rcmservo.estimation.broyden import BroydenEstimator, learn, update
from rcmservo.estimation.flow_rule import learn as flow_learn
from rcmservo.geometry.features import SCALE, about, difference, features
from rcmservo.geometry.projection import parameters

lengths = st.one_of(st.floats(1e-3, 1), st.floats(1, 10), st.floats(10, 1e3))


def problem(seed):
    random = random_from(seed)
    way = random.standard_normal(3)
    return random.uniform(-5, 5, (3, 3)), random.uniform(-5, 5, (3, 3)), way / np.linalg.norm(way)


@given(seeds, lengths)
def test_after_an_update_the_secant_equation_holds_exactly(seed, length):
    _, J_hat, way = problem(seed)
    delta_p, delta_y = length * way, random_from(seed + 1).uniform(-50, 50, 3)
    after = learn(J_hat, delta_p, delta_y)
    assert np.allclose(after @ delta_p, delta_y, rtol=1e-12, atol=1e-12 * max(length, 50))


@given(seeds, lengths)
def test_orthogonal_directions_are_left_alone(seed, length):
    J, J_hat, way = problem(seed)
    after = learn(J_hat, length * way, J @ (length * way))
    across = np.eye(3) - np.outer(way, way)
    assert np.allclose(after @ across, J_hat @ across, atol=1e-12)


@given(seeds, lengths)
def test_no_other_jacobian_that_explains_the_displacement_is_nearer(seed, length):
    J, J_hat, way = problem(seed)
    after = learn(J_hat, length * way, J @ (length * way))
    other = after + random_from(seed + 1).uniform(-5, 5, (3, 3)) @ (np.eye(3) - np.outer(way, way))
    assert np.linalg.norm(after - J_hat) <= np.linalg.norm(other - J_hat) * (1 + 1e-12)


@given(seeds, lengths)
def test_no_row_of_the_error_grows_while_the_true_jacobian_stays(seed, length):
    J, J_hat, way = problem(seed)
    after = learn(J_hat, length * way, J @ (length * way))
    R, R_after = np.sum((J_hat - J) ** 2, axis=1), np.sum((after - J) ** 2, axis=1)
    assert np.all(R_after <= R * (1 + 1e-12))


@given(seeds)
def test_a_constant_jacobian_is_learnt_exactly_from_three_orthogonal_steps(seed):
    J, _, _ = problem(seed)
    J_hat = np.zeros((3, 3))
    for way in np.linalg.qr(random_from(seed + 1).standard_normal((3, 3)))[0]:
        J_hat = learn(J_hat, 5.0 * way, J @ (5.0 * way))
    assert np.allclose(J_hat, J, atol=1e-12)


@given(seeds)
def test_independent_steps_over_and_over_lead_to_a_constant_jacobian(seed):
    """Steps that are not orthogonal undo a part of each other, so that one round is not enough."""
    J, J_hat, _ = problem(seed)
    ways = np.eye(3) + 0.2 * random_from(seed + 1).uniform(-1, 1, (3, 3))
    for _ in range(60):
        for way in ways:
            J_hat = learn(J_hat, way, J @ way)
    assert np.allclose(J_hat, J, atol=1e-9)


@given(seeds, lengths)
def test_it_is_the_flow_rule_28_with_a_boundless_gain(seed, length):
    J, J_hat, way = problem(seed)
    delta_p = length * way
    assert np.allclose(
        learn(J_hat, delta_p, J @ delta_p),
        flow_learn(J_hat, delta_p, J @ delta_p, 1.0, 1e12),
        atol=1e-9,
    )


def frames(seed, steps):
    """What a camera sees of marker 1 at places `steps` (n, 3) mm from a first one, and its o_c."""
    random = random_from(seed)
    places = tool_positions(random, 1)[0] + steps
    C = true_camera(random, places)
    return [Sample(p, markers_seen(C, p), parameters(C)[1], 0.02) for p in places]


@given(seeds, st.floats(0.1, 10.0), st.floats(0.0, 0.99))
def test_below_min_step_nothing_is_learnt_however_often_it_is_seen(seed, min_step, share):
    estimator, tool = BroydenEstimator(min_step), TOOLS["rigid"]
    _, _, way = problem(seed)
    first, *rest = frames(seed, np.outer([0.0, share, -share, share], min_step * way))
    memory = estimator.update(estimator.init(), tool, first)
    for sample in rest:
        memory = estimator.update(memory, tool, sample)
    assert not memory.J_hat.any()
    assert memory.p1 is first.p1


@given(seeds)
def test_small_steps_add_up_until_they_are_worth_learning_from(seed):
    estimator, tool = BroydenEstimator(min_step=1.0), TOOLS["rigid"]
    _, _, way = problem(seed)
    samples = frames(seed, np.outer(0.3 * np.arange(9), way))
    memory, learnt = estimator.init(), []
    for i, sample in enumerate(samples):
        before, memory = memory, estimator.update(memory, tool, sample)
        if not np.array_equal(memory.J_hat, before.J_hat):
            learnt.append(i)
    assert learnt == [4, 8]
    last, o_c = samples[-1], samples[-1].o_c
    change = difference(features(about(last.points, o_c)), features(about(samples[4].points, o_c)))
    assert np.allclose(memory.J_hat @ (last.p1 - samples[4].p1) / SCALE, change / SCALE, atol=1e-9)


def test_features_of_both_ends_are_taken_about_the_present_origin():
    p, points = np.array([0.0, 0.0, 100.0]), np.array([[10.0, 20.0], [30.0, 50.0]])
    J, learnt = update(np.zeros((3, 3)), p, points, p + 2.0, points, np.array([40.0, -25.0]), 1.0)
    assert learnt
    assert not J.any()


def test_a_turn_across_half_a_turn_is_learnt_as_the_small_turn_it_is():
    before, after = (
        np.array([[-50.0, 1.0], [-150.0, 2.0]]),
        np.array([[-50.0, -1.0], [-150.0, -2.0]]),
    )
    J, _ = update(
        np.zeros((3, 3)), np.zeros(3), before, np.array([1.0, 0, 0]), after, np.zeros(2), 1.0
    )
    assert abs(J[0, 0]) < 0.1


def test_the_first_frame_teaches_nothing_and_there_is_no_model_of_the_markers():
    estimator, tool = BroydenEstimator(), TOOLS["rigid"]
    first, second = frames(3, np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 0.0]]))
    memory = estimator.update(estimator.init(), tool, first)
    assert not estimator.jacobian(memory, tool, first).any()
    assert estimator.jacobian(estimator.update(memory, tool, second), tool, second).any()
    assert not memory.J_hat.any()
    assert estimator.predict(memory, tool, first.p1) is None


@pytest.mark.parametrize("min_step", [0.0, -1.0, np.nan, np.inf])
def test_a_step_that_is_no_positive_length_is_refused(min_step):
    with pytest.raises(BadInput, match="min_step"):
        BroydenEstimator(min_step)
