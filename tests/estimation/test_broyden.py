"""Broyden's update: the smallest change that explains a displacement of at least `min_step`."""

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
)
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Sample
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.displacement import apply_rank_one_update
from rcmservo.estimation.flow_rule import integrate_flow_rule
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    compute_feature_error,
    compute_features,
    shift_to_rcm,
)
from rcmservo.geometry.projection import extract_parameters


def broyden_update(J, delta_p, delta_y):
    return apply_rank_one_update(J, delta_p, delta_y, 1.0)


lengths = st.one_of(st.floats(1e-3, 1), st.floats(1, 10), st.floats(10, 1e3))


def problem(seed):
    random = make_random(seed)
    direction = random.standard_normal(3)
    return (
        random.uniform(-5, 5, (3, 3)),
        random.uniform(-5, 5, (3, 3)),
        direction / np.linalg.norm(direction),
    )


@given(seeds, lengths)
def test_after_an_update_the_secant_equation_holds_exactly(seed, length):
    _, J_hat, direction = problem(seed)
    delta_p, delta_y = length * direction, make_random(seed + 1).uniform(-50, 50, 3)
    after = broyden_update(J_hat, delta_p, delta_y)
    assert np.allclose(after @ delta_p, delta_y, rtol=1e-12, atol=1e-12 * max(length, 50))


@given(seeds, lengths)
def test_orthogonal_directions_stay_unchanged(seed, length):
    J, J_hat, direction = problem(seed)
    after = broyden_update(J_hat, length * direction, J @ (length * direction))
    across = np.eye(3) - np.outer(direction, direction)
    assert np.allclose(after @ across, J_hat @ across, atol=1e-12)


@given(seeds, lengths)
def test_no_other_jacobian_that_explains_the_displacement_is_nearer(seed, length):
    J, J_hat, direction = problem(seed)
    after = broyden_update(J_hat, length * direction, J @ (length * direction))
    other = after + make_random(seed + 1).uniform(-5, 5, (3, 3)) @ (
        np.eye(3) - np.outer(direction, direction)
    )
    assert np.linalg.norm(after - J_hat) <= np.linalg.norm(other - J_hat) * (1 + 1e-12)


@given(seeds, lengths)
def test_no_row_of_the_error_grows_while_the_true_jacobian_stays(seed, length):
    J, J_hat, direction = problem(seed)
    after = broyden_update(J_hat, length * direction, J @ (length * direction))
    R, R_after = np.sum((J_hat - J) ** 2, axis=1), np.sum((after - J) ** 2, axis=1)
    assert np.all(R_after <= R * (1 + 1e-12))


@given(seeds)
def test_three_orthogonal_steps_determine_a_constant_jacobian_exactly(seed):
    J, _, _ = problem(seed)
    J_hat = np.zeros((3, 3))
    for direction in np.linalg.qr(make_random(seed + 1).standard_normal((3, 3)))[0]:
        J_hat = broyden_update(J_hat, 5.0 * direction, J @ (5.0 * direction))
    assert np.allclose(J_hat, J, atol=1e-12)


@given(seeds)
def test_repeated_independent_steps_converge_to_a_constant_jacobian(seed):
    """Steps that are not orthogonal partly undo each other, so that one round is not enough."""
    J, J_hat, _ = problem(seed)
    directions = np.eye(3) + 0.2 * make_random(seed + 1).uniform(-1, 1, (3, 3))
    for _ in range(60):
        for direction in directions:
            J_hat = broyden_update(J_hat, direction, J @ direction)
    assert np.allclose(J_hat, J, atol=1e-9)


@given(seeds, lengths)
def test_it_is_the_limit_of_flow_rule_28_for_a_large_gain(seed, length):
    J, J_hat, direction = problem(seed)
    delta_p = length * direction
    assert np.allclose(
        broyden_update(J_hat, delta_p, J @ delta_p),
        integrate_flow_rule(J_hat, delta_p, J @ delta_p, 1.0, 1e12),
        atol=1e-9,
    )


def frames(seed, steps):
    """Return frames with marker 1 at `steps` (n, 3) mm from a first position."""
    random = make_random(seed)
    positions = draw_tool_positions(random, 1)[0] + steps
    C = draw_calibration_matrix(random, positions)
    return [Sample(p, project_markers(C, p), extract_parameters(C)[1], 0.02) for p in positions]


@given(seeds, st.floats(0.1, 10.0), st.floats(0.0, 0.99))
def test_displacements_below_min_step_never_change_the_estimate(seed, min_step, fraction):
    estimator, tool = BroydenEstimator(min_step), TOOLS["rigid"]
    _, _, direction = problem(seed)
    first, *later_samples = frames(
        seed, np.outer([0.0, fraction, -fraction, fraction], min_step * direction)
    )
    memory = estimator.update(estimator.init(), tool, first)
    for sample in later_samples:
        memory = estimator.update(memory, tool, sample)
    assert not memory.J_hat.any()
    assert memory.p1 is first.p1


@given(seeds)
def test_small_steps_add_up_to_a_displacement(seed):
    estimator, tool = BroydenEstimator(min_step=1.0), TOOLS["rigid"]
    _, _, direction = problem(seed)
    samples = frames(seed, np.outer(0.3 * np.arange(9), direction))
    memory, updated = estimator.init(), []
    for i, sample in enumerate(samples):
        before, memory = memory, estimator.update(memory, tool, sample)
        if not np.array_equal(memory.J_hat, before.J_hat):
            updated.append(i)
    assert updated == [4, 8]
    last, o_c = samples[-1], samples[-1].o_c
    change = compute_feature_error(
        compute_features(shift_to_rcm(last.points, o_c)),
        compute_features(shift_to_rcm(samples[4].points, o_c)),
    )
    assert np.allclose(
        memory.J_hat @ (last.p1 - samples[4].p1) / FEATURE_SCALE, change / FEATURE_SCALE, atol=1e-9
    )


def test_the_first_frame_changes_nothing_and_markers_are_not_predicted():
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
