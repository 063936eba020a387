"""The control law: exact for a well-conditioned Ĵ, speed limit, damping near singularities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.control import saturated_controller
from rcmservo.control.saturated_controller import (
    ControllerOutput,
    SaturatedController,
    compute_controller_output,
    compute_potential,
    compute_potential_gradient,
)
from rcmservo.errors import BadInput

MAX_CONDITION = 150.0
NO_SPEED_LIMIT = 1e9
BOUNDS = np.array([5.0, 2.0, 4.0, 5.0, 3.0, 5.0])
"""Scaled bounds of up to six features."""

counts = st.sampled_from([3, 4, 6])
"""Numbers of features."""


def jacobian(seed, sigma, n=3):
    """Return a scaled Ĵ (n, 3) with the singular values `sigma`."""
    random = make_random(seed)
    U, V = (np.linalg.qr(random.standard_normal((size, 3)))[0] for size in (n, 3))
    return U * sigma @ V.T


def gradient_of(seed, n=3):
    return make_random(seed + 1).uniform(-1, 1, n) * BOUNDS[:n]


def law(*arguments):
    """Return the result of the control law with v as an array (3,)."""
    v, *quality = saturated_controller.solve_velocity(*arguments)
    return ControllerOutput(np.array(v), *quality)


def speed(v):
    return float(np.linalg.norm(v))


conditions = st.floats(1.0, 0.499 * MAX_CONDITION)


@given(seeds, conditions, st.floats(0.01, 10), st.floats(1e-3, 10), counts)
def test_a_well_conditioned_estimate_gives_exactly_the_papers_law(seed, condition, size, gain, n):
    """More than three features are solved by least squares, with a remaining error."""
    sigma = size * np.array([1.0, 1 / np.sqrt(condition), 1 / condition])
    J, g = jacobian(seed, sigma, n), gradient_of(seed, n)
    v, estimated_condition, reducible, _ = law(J, g, gain, MAX_CONDITION, NO_SPEED_LIMIT)
    best = np.linalg.pinv(J) @ g
    assert np.allclose(v, -gain * best, rtol=1e-8, atol=1e-8 * speed(v))
    assert estimated_condition == pytest.approx(condition, rel=1e-6)
    assert reducible == pytest.approx(g @ J @ best / (g @ g), abs=1e-9)


@given(seeds, conditions, st.floats(1e-3, 100))
def test_the_speed_cap_keeps_the_direction(seed, condition, cap):
    J, g = jacobian(seed, np.array([1.0, 0.7, 1 / condition])), gradient_of(seed)
    free, capped = (
        law(J, g, 2.0, MAX_CONDITION, NO_SPEED_LIMIT).v,
        law(J, g, 2.0, MAX_CONDITION, cap).v,
    )
    assert speed(capped) <= cap * (1 + 1e-12)
    left = law(J, g, 2.0, MAX_CONDITION, cap).distance_to_target
    assert left == pytest.approx(speed(free) / 2.0), "the distance does not depend on the speed"
    assert speed(capped) == pytest.approx(min(cap, speed(free)))
    assert np.allclose(
        capped * speed(free), free * speed(capped), atol=1e-9 * speed(free) * speed(capped)
    )


def blocked(seed, condition):
    """Return a scaled Ĵ and its left singular vectors; the last one is the weak direction."""
    J = jacobian(seed, np.array([1.0, 0.5, 1 / condition]))
    return J, np.linalg.svd(J)[0]


@given(seeds, st.floats(100.0 * MAX_CONDITION, 1e300))
def test_beyond_any_condition_only_the_observable_error_is_reduced(seed, condition):
    J, U = blocked(seed, condition)
    observable = U[:, :2] @ make_random(seed).uniform(0.1, 1.0, 2)
    v, estimated_condition, reducible, _ = law(
        J, observable + U[:, 2], 2.0, MAX_CONDITION, NO_SPEED_LIMIT
    )
    assert np.allclose(J @ v, -2.0 * observable, atol=0.01 * speed(observable))
    assert (
        estimated_condition == pytest.approx(condition, rel=1e-3)
        or min(estimated_condition, condition) > 1e12
    )
    assert reducible == pytest.approx(
        observable @ observable / (observable @ observable + 1.0), abs=0.01
    )


@given(seeds)
def test_the_reducible_fraction_vanishes_for_an_error_in_the_weak_direction(seed):
    fractions = []
    for condition in (
        0.4 * MAX_CONDITION,
        2.0 * MAX_CONDITION,
        20.0 * MAX_CONDITION,
        1e4 * MAX_CONDITION,
    ):
        J, U = blocked(seed, condition)
        fractions.append(
            law(J, U[:, 2].copy(), 2.0, MAX_CONDITION, NO_SPEED_LIMIT).reducible_fraction
        )
        assert law(
            J, U[:, 0].copy(), 2.0, MAX_CONDITION, NO_SPEED_LIMIT
        ).reducible_fraction == pytest.approx(1.0)
    assert fractions[0] == pytest.approx(1.0)
    assert np.all(np.diff(fractions) < 0.0) and fractions[2] < 0.01 and fractions[3] < 1e-6


def test_without_an_error_nothing_moves_and_the_reducible_fraction_is_one():
    output = law(jacobian(1, np.ones(3)), np.zeros(3), 2.0, MAX_CONDITION, NO_SPEED_LIMIT)
    assert not output.v.any() and output.reducible_fraction == 1.0


@given(seeds, st.booleans())
def test_the_law_is_applied_to_the_saturated_error_and_its_size_is_that_of_the_potential(
    seed, follows_paper
):
    J, delta = jacobian(seed, np.array([1.0, 0.5, 0.1])), 3.0 * gradient_of(seed)
    output, error = compute_controller_output(
        J, delta, BOUNDS[:3], follows_paper, 2.0, MAX_CONDITION, 40.0
    )
    expected = law(
        J, compute_potential_gradient(delta, BOUNDS[:3], follows_paper), 2.0, MAX_CONDITION, 40.0
    )
    assert np.array_equal(output.v, expected.v) and output[1:] == expected[1:]
    V = compute_potential(delta, BOUNDS[:3], follows_paper)
    assert error == pytest.approx(np.sqrt(2.0 * V))


def test_a_null_estimate_moves_nothing():
    v, condition, reducible, _ = law(np.zeros((3, 3)), np.ones(3), 2.0, MAX_CONDITION, 40.0)
    assert not v.any() and condition == np.inf and reducible == 0.0


@pytest.mark.parametrize("invalid", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("index", [(0, 0), (2, 1)])
def test_an_estimate_that_is_not_finite_moves_nothing(invalid, index):
    J = jacobian(1, np.ones(3))
    J[index] = invalid
    v, condition, reducible, _ = law(J, np.ones(3), 2.0, MAX_CONDITION, 40.0)
    assert not v.any() and condition == np.inf and reducible == 0.0


@given(seeds, st.floats(1e-300, 1.0), st.floats(0.01, 10))
def test_the_damped_speed_stays_bounded_as_the_least_singular_value_vanishes(seed, least, size):
    """It is at most 1.21 times the undamped speed at half the limit, where damping begins."""
    g, gain = gradient_of(seed), 2.0
    sigma = size * np.array([1.0, max(least, 0.3), least])
    v = law(jacobian(seed, sigma), g, gain, MAX_CONDITION, NO_SPEED_LIMIT).v
    assert speed(v) <= 1.21 * gain * MAX_CONDITION / (2 * size) * np.linalg.norm(g)


@given(seeds, st.floats(0.5 * MAX_CONDITION, 1e6 * MAX_CONDITION))
def test_damping_never_turns_the_motion_away_from_the_target(seed, condition):
    """With Ĵ = J, V decreases along v for any damping: the scaled J Ĵ⁻¹ stays positive definite."""
    J, g = jacobian(seed, np.array([1.0, 0.1, 1 / condition])), gradient_of(seed)
    v = law(J, g, 2.0, MAX_CONDITION, NO_SPEED_LIMIT).v
    assert (g) @ (J @ v) < 0


@given(seeds, st.floats(1e-6, 0.49 * MAX_CONDITION), st.sampled_from([False, True]))
def test_the_condition_does_not_depend_on_the_unit_of_length(seed, condition, in_metres):
    J = jacobian(seed, np.array([1.0, 0.5, 1 / max(condition, 2.0)])) * (
        1000.0 if in_metres else 1.0
    )
    estimated_condition = law(J, np.ones(3), 1.0, MAX_CONDITION, NO_SPEED_LIMIT).condition
    assert estimated_condition == pytest.approx(max(condition, 2.0), rel=1e-6)


@given(seeds, conditions, st.sampled_from([False, True]))
def test_equation_33_the_potential_falls_all_the_way_to_zero_and_the_error_with_it(
    seed, condition, follows_paper
):
    """With Ĵ = J, ẏ = J v is ẏ = -k ∂V/∂y."""
    J, gain, dt = jacobian(seed, np.array([1.0, 0.4, 1 / condition])), 2.0, 0.05
    bounds = BOUNDS[:3]
    delta = make_random(seed + 2).uniform(-3, 3, 3) * bounds
    V = compute_potential(delta, bounds, follows_paper)
    for _ in range(250):
        gradient = compute_potential_gradient(delta, bounds, follows_paper)
        v = law(J, gradient, gain, MAX_CONDITION, NO_SPEED_LIMIT).v
        assert np.allclose(J @ v, -gain * gradient, atol=1e-8 * bounds.max())
        delta = delta + dt * (J @ v)
        V, before = compute_potential(delta, bounds, follows_paper), V
        assert before > V or before < 1e-12
    assert np.all(np.abs(delta) < 1e-2 * bounds)


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 6), st.booleans())
def test_the_potential_is_positive_and_symmetric_and_its_gradient_saturates(delta, follows_paper):
    delta = np.array(delta)
    V, g = (
        compute_potential(delta, BOUNDS, follows_paper),
        compute_potential_gradient(delta, BOUNDS, follows_paper),
    )
    assert V >= 0 and (V > 0 or np.allclose(delta, 0, atol=1e-150))
    assert compute_potential(-delta, BOUNDS, follows_paper) == V
    assert np.array_equal(g, -compute_potential_gradient(-delta, BOUNDS, follows_paper))
    assert np.all(np.abs(g) <= BOUNDS) and np.all(g * delta >= 0)


@given(seeds, conditions)
def test_the_law_leaves_its_inputs_unchanged(seed, condition):
    J, g = jacobian(seed, np.array([1.0, 0.7, 1 / condition])), gradient_of(seed)
    before = J.copy(), g.copy()
    law(J, g, 2.0, MAX_CONDITION, 1.0)
    assert np.array_equal(J, before[0]) and np.array_equal(g, before[1])


@pytest.mark.parametrize(
    "invalid",
    [
        {"gain": 0.0},
        {"gain": -0.1},
        {"gain": np.nan},
        {"bounds": (1.0, 10.0)},
        {"bounds": (1.0, 10.0, 0.0)},
        {"bounds": (1.0, 10.0, np.nan)},
        {"features": "lines"},
        {"potential": "quadratic"},
        {"max_speed": 0.0},
        {"max_speed": np.inf},
        {"max_condition": 1.0},
        {"max_condition": np.nan},
    ],
)
def test_settings_that_cannot_work_are_refused_by_name(invalid):
    with pytest.raises(BadInput, match=next(iter(invalid))):
        SaturatedController(**invalid)
