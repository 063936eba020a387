"""Normalised flow: a displacement teaches one share of its news at any speed, and with a share of 1
it is Broyden's update.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import TOOLS, frozen, markers_seen, random_from, seeds, tool_positions, true_camera
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Sample
from rcmservo.estimation.broyden import BroydenEstimator
from rcmservo.estimation.flow_rule import learn as flow_learn
from rcmservo.estimation.normalised_flow import NormalisedFlowEstimator
from rcmservo.geometry.projection import parameters

lengths = st.one_of(st.floats(1e-3, 1), st.floats(1, 10), st.floats(10, 1e3))
shares = st.floats(0.01, 1.99)
TOOL = TOOLS["rigid"]


def problem(seed):
    random = random_from(seed)
    way = random.standard_normal(3)
    return random.uniform(-5, 5, (3, 3)), random.uniform(-5, 5, (3, 3)), way / np.linalg.norm(way)


def learn(J_hat, delta_p, delta_y, mu):
    return NormalisedFlowEstimator(mu=mu).update_jacobian(J_hat, np.empty(0), delta_p, delta_y)[0]


def frames(seed, dt):
    random = random_from(seed)
    places = tool_positions(random, 1)[0] + random.uniform(-20, 20, (12, 3))
    C = true_camera(random, places)
    return [Sample(p, markers_seen(C, p), parameters(C)[1], dt) for p in places]


@given(seeds)
def test_with_a_share_of_1_it_is_broydens_update_frame_by_frame(seed):
    ours, broyden = NormalisedFlowEstimator(mu=1.0, min_step=4.0), BroydenEstimator(min_step=4.0)
    memory, other = ours.init(), broyden.init()
    for sample in frames(seed, 0.02):
        memory = ours.update(memory, TOOL, sample)
        other = broyden.update(other, TOOL, sample)
        assert np.array_equal(memory.J_hat, other.J_hat)
    assert memory.J_hat.any()


@given(seeds, lengths, shares)
def test_the_error_along_the_motion_is_one_less_the_share_and_across_it_as_before(seed, length, mu):
    J, J_hat, way = problem(seed)
    error = J_hat - J
    after = learn(J_hat, length * way, J @ (length * way), mu) - J
    assert np.allclose(after @ way, (1.0 - mu) * (error @ way), atol=1e-9)
    across = np.eye(3) - np.outer(way, way)
    assert np.allclose(after @ across, error @ across, atol=1e-9)


@given(seeds, lengths, shares)
def test_no_row_of_the_error_grows_for_any_share_below_2(seed, length, mu):
    J, J_hat, way = problem(seed)
    after = learn(J_hat, length * way, J @ (length * way), mu)
    R, R_after = np.sum((J_hat - J) ** 2, axis=1), np.sum((after - J) ** 2, axis=1)
    assert np.all(R_after <= R * (1 + 1e-12))


@pytest.mark.parametrize("speed", [0.01, 1.0, 100.0])
def test_speed_does_not_matter_where_rule_28_learns_more_in_haste(speed):
    estimator = NormalisedFlowEstimator()
    memory, usual = estimator.init(), estimator.init()
    for one, other in zip(frames(1, 0.02 / speed), frames(1, 0.02), strict=True):
        memory = estimator.update(memory, TOOL, one)
        usual = estimator.update(usual, TOOL, other)
    assert frozen(memory) == frozen(usual)
    J, J_hat, way = problem(1)
    slow, fast = (flow_learn(J_hat, 3.0 * way, J @ (3.0 * way), dt, 1e-3) for dt in (1.0, 1e-3))
    assert np.linalg.norm(slow - J_hat) < 0.02 * np.linalg.norm(fast - J_hat)


@given(seeds, lengths, st.floats(1e-3, 10.0), st.floats(1e-4, 1.0))
def test_it_is_rule_28_with_the_gain_that_its_speed_asks_for(seed, length, dt, gamma):
    J, J_hat, way = problem(seed)
    delta_p = length * way
    mu = -np.expm1(-gamma * length**2 / dt)
    if not mu > 0.0:
        return
    assert np.allclose(
        learn(J_hat, delta_p, J @ delta_p, mu),
        flow_learn(J_hat, delta_p, J @ delta_p, dt, gamma),
        atol=1e-9,
    )


def test_a_smaller_share_lets_less_noise_in():
    errors = {mu: [] for mu in (0.2, 0.5, 1.0)}
    for seed, (mu, found) in ((s, one) for s in range(20) for one in errors.items()):
        random, (J, _, _) = random_from(seed), problem(seed)
        J_hat = J
        for way in 3.0 * random.standard_normal((100, 3)):
            J_hat = learn(J_hat, way, J @ way + random.standard_normal(3), mu)
        found.append(np.linalg.norm(J_hat - J))
    least, usual, most = (np.median(found) for found in errors.values())
    assert least < 0.7 * usual and usual < 0.7 * most


@pytest.mark.parametrize("mu", [0.0, -0.1, 2.0, np.nan, np.inf])
def test_a_share_that_does_not_converge_is_one_sentence(mu):
    with pytest.raises(BadInput, match=r"mu must be a number above 0 and below 2, got") as refused:
        NormalisedFlowEstimator(mu=mu)
    assert len(str(refused.value).splitlines()) == 1
