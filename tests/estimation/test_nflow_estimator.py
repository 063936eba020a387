"""The normalised flow rule: the same fraction at any speed, and Broyden's update for μ = 1."""

from itertools import product

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
from rcmservo.estimation.flow_rule import integrate_flow_rule
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.geometry.projection import extract_parameters

lengths = st.one_of(st.floats(1e-3, 1), st.floats(1, 10), st.floats(10, 1e3))
gains = st.floats(0.01, 1.99)
TOOL = TOOLS["rigid"]


def problem(seed):
    random = make_random(seed)
    direction = random.standard_normal(3)
    return (
        random.uniform(-5, 5, (3, 3)),
        random.uniform(-5, 5, (3, 3)),
        direction / np.linalg.norm(direction),
    )


def normalised_update(J_hat, delta_p, delta_y, mu):
    return NormalisedFlowEstimator(mu=mu).update_jacobian(J_hat, np.empty(0), delta_p, delta_y)[0]


def frames(seed, dt):
    random = make_random(seed)
    positions = draw_tool_positions(random, 1)[0] + random.uniform(-20, 20, (12, 3))
    C = draw_calibration_matrix(random, positions)
    return [Sample(p, project_markers(C, p), extract_parameters(C)[1], dt) for p in positions]


@given(seeds)
def test_with_mu_1_it_is_broydens_update_frame_by_frame(seed):
    normalised, broyden = (
        NormalisedFlowEstimator(mu=1.0, min_step=4.0),
        BroydenEstimator(min_step=4.0),
    )
    memory, expected = normalised.init(), broyden.init()
    for sample in frames(seed, 0.02):
        memory = normalised.update(memory, TOOL, sample)
        expected = broyden.update(expected, TOOL, sample)
        assert np.array_equal(memory.J_hat, expected.J_hat)
    assert memory.J_hat.any()


@given(seeds, lengths, gains)
def test_the_error_shrinks_by_1_minus_mu_along_the_motion_and_stays_across_it(seed, length, mu):
    J, J_hat, direction = problem(seed)
    error = J_hat - J
    after = normalised_update(J_hat, length * direction, J @ (length * direction), mu) - J
    assert np.allclose(after @ direction, (1.0 - mu) * (error @ direction), atol=1e-9)
    across = np.eye(3) - np.outer(direction, direction)
    assert np.allclose(after @ across, error @ across, atol=1e-9)


@given(seeds, lengths, gains)
def test_no_row_of_the_error_grows_for_any_mu_below_2(seed, length, mu):
    J, J_hat, direction = problem(seed)
    after = normalised_update(J_hat, length * direction, J @ (length * direction), mu)
    R, R_after = np.sum((J_hat - J) ** 2, axis=1), np.sum((after - J) ** 2, axis=1)
    assert np.all(R_after <= R * (1 + 1e-12))


@pytest.mark.parametrize("speed", [0.01, 1.0, 100.0])
def test_speed_does_not_matter_while_rule_28_adapts_more_in_fast_motion(speed):
    estimator = NormalisedFlowEstimator()
    memory, usual = estimator.init(), estimator.init()
    for one, expected in zip(frames(1, 0.02 / speed), frames(1, 0.02), strict=True):
        memory = estimator.update(memory, TOOL, one)
        usual = estimator.update(usual, TOOL, expected)
    assert snapshot(memory) == snapshot(usual)
    J, J_hat, direction = problem(1)
    slow, fast = (
        integrate_flow_rule(J_hat, 3.0 * direction, J @ (3.0 * direction), dt, 1e-3)
        for dt in (1.0, 1e-3)
    )
    assert np.linalg.norm(slow - J_hat) < 0.02 * np.linalg.norm(fast - J_hat)


@given(seeds, lengths, st.floats(1e-3, 10.0), st.floats(1e-4, 1.0))
def test_it_is_rule_28_with_the_gain_for_the_speed(seed, length, dt, gamma):
    J, J_hat, direction = problem(seed)
    delta_p = length * direction
    mu = -np.expm1(-gamma * length**2 / dt)
    if not mu > 0.0:
        return
    assert np.allclose(
        normalised_update(J_hat, delta_p, J @ delta_p, mu),
        integrate_flow_rule(J_hat, delta_p, J @ delta_p, dt, gamma),
        atol=1e-9,
    )


def test_a_smaller_mu_admits_less_noise():
    errors = {mu: [] for mu in (0.2, 0.5, 1.0)}
    for seed, (mu, final_errors) in product(range(20), errors.items()):
        random, (J, _, _) = make_random(seed), problem(seed)
        J_hat = J
        for direction in 3.0 * random.standard_normal((100, 3)):
            J_hat = normalised_update(
                J_hat, direction, J @ direction + random.standard_normal(3), mu
            )
        final_errors.append(np.linalg.norm(J_hat - J))
    medians = [np.median(final_errors) for final_errors in errors.values()]
    assert medians[0] < 0.7 * medians[1] and medians[1] < 0.7 * medians[2]


@pytest.mark.parametrize("mu", [0.0, -0.1, 2.0, np.nan, np.inf])
def test_a_mu_without_convergence_is_refused_in_one_sentence(mu):
    with pytest.raises(BadInput, match=r"mu must be a number above 0 and below 2, got") as refused:
        NormalisedFlowEstimator(mu=mu)
    assert len(str(refused.value).splitlines()) == 1
