"""The law: (31) exactly where Ĵ is good, slower in the same direction where that is too fast, else
no motion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.errors import BadInput
from rcmservo.method.controller import (
    SaturatedController,
    law,
    potential,
    potential_gradient,
    scaled,
)
from rcmservo.method.features import SCALE

LIMIT = 150.0
FAST = 1e9
BOUNDS = np.array([np.radians(50.0), 50.0, 50.0])


def jacobian(seed, sigma):
    """A Ĵ whose scaled singular values are `sigma`."""
    random = random_from(seed)
    U, V = (np.linalg.qr(random.standard_normal((3, 3)))[0] for _ in range(2))
    return SCALE[:, None] * (U * sigma @ V.T)


def gradient_of(seed):
    return random_from(seed + 1).uniform(-1, 1, 3) * BOUNDS


def speed(v):
    return float(np.linalg.norm(v))


conditions = st.floats(1.0, 0.499 * LIMIT)


@given(seeds, conditions, st.floats(0.01, 10), st.floats(1e-3, 10))
def test_a_well_conditioned_estimate_gives_exactly_the_papers_law(seed, condition, size, gain):
    J, g = (
        jacobian(seed, size * np.array([1.0, 1 / np.sqrt(condition), 1 / condition])),
        gradient_of(seed),
    )
    v, found = law(J, g, gain, LIMIT, FAST)
    assert np.allclose(v, -gain * np.linalg.solve(J, g), rtol=1e-8, atol=1e-8 * speed(v))
    assert found == pytest.approx(condition, rel=1e-6)


@given(seeds, conditions, st.floats(1e-3, 100))
def test_the_speed_cap_keeps_the_direction(seed, condition, cap):
    J, g = jacobian(seed, np.array([1.0, 0.7, 1 / condition])), gradient_of(seed)
    free, capped = law(J, g, 2.0, LIMIT, FAST)[0], law(J, g, 2.0, LIMIT, cap)[0]
    assert speed(capped) <= cap * (1 + 1e-12)
    assert speed(capped) == pytest.approx(min(cap, speed(free)))
    assert np.allclose(
        capped * speed(free), free * speed(capped), atol=1e-9 * speed(free) * speed(capped)
    )


@given(seeds, st.one_of(st.floats(LIMIT * 1.001, 1e300), st.just(np.inf)))
def test_beyond_the_limit_of_the_condition_nothing_moves_and_the_condition_says_why(
    seed, condition
):
    v, found = law(
        jacobian(seed, np.array([1.0, 0.5, 1 / condition])), gradient_of(seed), 2.0, LIMIT, FAST
    )
    assert not v.any()
    assert found > LIMIT


def test_a_null_estimate_moves_nothing():
    v, condition = law(np.zeros((3, 3)), np.ones(3), 2.0, LIMIT, 40.0)
    assert not v.any() and condition == np.inf


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [(0, 0), (2, 1)])
def test_an_estimate_that_is_not_finite_moves_nothing(bad, where):
    J = jacobian(1, np.ones(3))
    J[where] = bad
    v, condition = law(J, np.ones(3), 2.0, LIMIT, 40.0)
    assert not v.any() and condition == np.inf


@given(seeds, st.floats(1e-300, 1.0), st.floats(0.01, 10))
def test_the_damped_speed_stays_bounded_as_the_least_singular_value_vanishes(seed, least, size):
    """At most 1.21 times what the law gives at half the limit, where damping begins."""
    g, gain = gradient_of(seed), 2.0
    sigma = size * np.array([1.0, max(least, 0.3), least])
    v, _ = law(jacobian(seed, sigma), g, gain, LIMIT, FAST)
    assert speed(v) <= 1.21 * gain * LIMIT / (2 * size) * np.linalg.norm(g / SCALE)


@given(seeds, st.floats(0.5 * LIMIT, 0.999 * LIMIT))
def test_damping_never_turns_the_motion_away_from_the_target(seed, condition):
    """If Ĵ = J, V falls along v however strong the damping: J Ĵ⁻¹ stays positive definite,
    scaled."""
    J, g = jacobian(seed, np.array([1.0, 0.1, 1 / condition])), gradient_of(seed)
    v, _ = law(J, g, 2.0, LIMIT, FAST)
    assert (g / SCALE) @ (scaled(J) @ v) < 0


@given(seeds, st.floats(1e-6, 0.49 * LIMIT), st.sampled_from([False, True]))
def test_the_condition_does_not_depend_on_the_unit_of_length(seed, condition, in_metres):
    J = jacobian(seed, np.array([1.0, 0.5, 1 / max(condition, 2.0)])) * (
        1000.0 if in_metres else 1.0
    )
    assert law(J, np.ones(3), 1.0, LIMIT, FAST)[1] == pytest.approx(max(condition, 2.0), rel=1e-6)


@given(seeds, conditions, st.sampled_from([False, True]))
def test_equation_33_the_potential_falls_all_the_way_to_zero_and_the_error_with_it(
    seed, condition, printed
):
    """ẏ = J v with Ĵ = J is ẏ = -k ∂V/∂y."""
    J, gain, dt = jacobian(seed, np.array([1.0, 0.4, 1 / condition])), 2.0, 0.05
    delta = random_from(seed + 2).uniform(-3, 3, 3) * BOUNDS
    V = potential(delta, BOUNDS, printed)
    for _ in range(250):
        gradient = potential_gradient(delta, BOUNDS, printed)
        v, _ = law(J, gradient, gain, LIMIT, FAST)
        assert np.allclose(J @ v, -gain * gradient, atol=1e-8 * BOUNDS.max())
        delta = delta + dt * (J @ v)
        V, before = potential(delta, BOUNDS, printed), V
        assert before > V or before < 1e-12
    assert np.all(np.abs(delta) < 1e-2 * BOUNDS)


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.booleans())
def test_the_potential_is_positive_and_symmetric_and_its_gradient_saturates(delta, printed):
    delta = np.array(delta)
    V, g = potential(delta, BOUNDS, printed), potential_gradient(delta, BOUNDS, printed)
    assert V >= 0 and (V > 0 or np.allclose(delta, 0, atol=1e-150))
    assert potential(-delta, BOUNDS, printed) == V
    assert np.array_equal(g, -potential_gradient(-delta, BOUNDS, printed))
    assert np.all(np.abs(g) <= BOUNDS) and np.all(g * delta >= 0)


@given(seeds, conditions)
def test_the_law_leaves_its_inputs_alone(seed, condition):
    J, g = jacobian(seed, np.array([1.0, 0.7, 1 / condition])), gradient_of(seed)
    before = J.copy(), g.copy()
    law(J, g, 2.0, LIMIT, 1.0)
    assert np.array_equal(J, before[0]) and np.array_equal(g, before[1])


@pytest.mark.parametrize(
    "wrong",
    [
        {"gain": 0.0},
        {"gain": -0.1},
        {"gain": np.nan},
        {"bounds": (1.0, 10.0)},
        {"bounds": (1.0, 10.0, 0.0)},
        {"bounds": (1.0, 10.0, np.nan)},
        {"potential": "quadratic"},
        {"max_speed": 0.0},
        {"max_speed": np.inf},
        {"max_condition": 1.0},
        {"max_condition": np.nan},
    ],
)
def test_settings_that_cannot_work_are_refused_by_name(wrong):
    with pytest.raises(BadInput, match=next(iter(wrong))):
        SaturatedController(**wrong)
