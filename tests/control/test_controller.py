"""The law: (31) exactly where Ĵ is good, slower in the same direction where that is too fast,
damped where Ĵ hardly tells, and it says how much of the error is left to it.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.control import saturated_controller
from rcmservo.control.saturated_controller import (
    Heading,
    SaturatedController,
    control,
    potential,
    potential_gradient,
)
from rcmservo.errors import BadInput

LIMIT = 150.0
FAST = 1e9
BOUNDS = np.array([5.0, 2.0, 4.0, 5.0, 3.0, 5.0])
"""Scaled, of up to six features."""

counts = st.sampled_from([3, 4, 6])
"""Of features."""


def jacobian(seed, sigma, n=3):
    """A scaled Ĵ (n, 3) whose singular values are `sigma`."""
    random = random_from(seed)
    U, V = (np.linalg.qr(random.standard_normal((size, 3)))[0] for size in (n, 3))
    return U * sigma @ V.T


def gradient_of(seed, n=3):
    return random_from(seed + 1).uniform(-1, 1, n) * BOUNDS[:n]


def law(*given):
    """The heading, with v as an array (3,)."""
    v, *others = saturated_controller.law(*given)
    return Heading(np.array(v), *others)


def speed(v):
    return float(np.linalg.norm(v))


conditions = st.floats(1.0, 0.499 * LIMIT)


@given(seeds, conditions, st.floats(0.01, 10), st.floats(1e-3, 10), counts)
def test_a_well_conditioned_estimate_gives_exactly_the_papers_law(seed, condition, size, gain, n):
    """By least squares where there are more features than three; these cannot all be worked
    off.
    """
    sigma = size * np.array([1.0, 1 / np.sqrt(condition), 1 / condition])
    J, g = jacobian(seed, sigma, n), gradient_of(seed, n)
    v, found, way, _ = law(J, g, gain, LIMIT, FAST)
    best = np.linalg.pinv(J) @ g
    assert np.allclose(v, -gain * best, rtol=1e-8, atol=1e-8 * speed(v))
    assert found == pytest.approx(condition, rel=1e-6)
    assert way == pytest.approx(g @ J @ best / (g @ g), abs=1e-9)


@given(seeds, conditions, st.floats(1e-3, 100))
def test_the_speed_cap_keeps_the_direction(seed, condition, cap):
    J, g = jacobian(seed, np.array([1.0, 0.7, 1 / condition])), gradient_of(seed)
    free, capped = law(J, g, 2.0, LIMIT, FAST).v, law(J, g, 2.0, LIMIT, cap).v
    assert speed(capped) <= cap * (1 + 1e-12)
    left = law(J, g, 2.0, LIMIT, cap).left
    assert left == pytest.approx(speed(free) / 2.0), "the way does not depend on the speed"
    assert speed(capped) == pytest.approx(min(cap, speed(free)))
    assert np.allclose(
        capped * speed(free), free * speed(capped), atol=1e-9 * speed(free) * speed(capped)
    )


def blocked(seed, condition):
    """A scaled Ĵ with its left singular vectors, the last being the direction it hardly tells."""
    J = jacobian(seed, np.array([1.0, 0.5, 1 / condition]))
    return J, np.linalg.svd(J)[0]


@given(seeds, st.floats(100.0 * LIMIT, 1e300))
def test_beyond_any_condition_it_works_off_what_the_estimate_tells_and_leaves_the_rest(
    seed, condition
):
    J, U = blocked(seed, condition)
    told = U[:, :2] @ random_from(seed).uniform(0.1, 1.0, 2)
    v, found, way, _ = law(J, told + U[:, 2], 2.0, LIMIT, FAST)
    assert np.allclose(J @ v, -2.0 * told, atol=0.01 * speed(told))
    assert found == pytest.approx(condition, rel=1e-3) or min(found, condition) > 1e12
    assert way == pytest.approx(told @ told / (told @ told + 1.0), abs=0.01)


@given(seeds)
def test_the_way_closes_as_the_error_lies_in_the_direction_that_the_estimate_hardly_tells(seed):
    ways = []
    for condition in (0.4 * LIMIT, 2.0 * LIMIT, 20.0 * LIMIT, 1e4 * LIMIT):
        J, U = blocked(seed, condition)
        ways.append(law(J, U[:, 2].copy(), 2.0, LIMIT, FAST).open)
        assert law(J, U[:, 0].copy(), 2.0, LIMIT, FAST).open == pytest.approx(1.0)
    assert ways[0] == pytest.approx(1.0)
    assert np.all(np.diff(ways) < 0.0) and ways[2] < 0.01 and ways[3] < 1e-6


def test_without_an_error_the_way_is_open_and_nothing_moves():
    heading = law(jacobian(1, np.ones(3)), np.zeros(3), 2.0, LIMIT, FAST)
    assert not heading.v.any() and heading.open == 1.0


@given(seeds, st.booleans())
def test_the_law_is_applied_to_the_saturated_error_and_its_size_is_that_of_the_potential(
    seed, printed
):
    J, delta = jacobian(seed, np.array([1.0, 0.5, 0.1])), 3.0 * gradient_of(seed)
    heading, error = control(J, delta, BOUNDS[:3], printed, 2.0, LIMIT, 40.0)
    wanted = law(J, potential_gradient(delta, BOUNDS[:3], printed), 2.0, LIMIT, 40.0)
    assert np.array_equal(heading.v, wanted.v) and heading[1:] == wanted[1:]
    V = potential(delta, BOUNDS[:3], printed)
    assert error == pytest.approx(np.sqrt(2.0 * V))


def test_a_null_estimate_moves_nothing():
    v, condition, way, _ = law(np.zeros((3, 3)), np.ones(3), 2.0, LIMIT, 40.0)
    assert not v.any() and condition == np.inf and way == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [(0, 0), (2, 1)])
def test_an_estimate_that_is_not_finite_moves_nothing(bad, where):
    J = jacobian(1, np.ones(3))
    J[where] = bad
    v, condition, way, _ = law(J, np.ones(3), 2.0, LIMIT, 40.0)
    assert not v.any() and condition == np.inf and way == 0.0


@given(seeds, st.floats(1e-300, 1.0), st.floats(0.01, 10))
def test_the_damped_speed_stays_bounded_as_the_least_singular_value_vanishes(seed, least, size):
    """At most 1.21 times what the law gives at half the limit, where damping begins."""
    g, gain = gradient_of(seed), 2.0
    sigma = size * np.array([1.0, max(least, 0.3), least])
    v = law(jacobian(seed, sigma), g, gain, LIMIT, FAST).v
    assert speed(v) <= 1.21 * gain * LIMIT / (2 * size) * np.linalg.norm(g)


@given(seeds, st.floats(0.5 * LIMIT, 1e6 * LIMIT))
def test_damping_never_turns_the_motion_away_from_the_target(seed, condition):
    """If Ĵ = J, V falls along v however strong the damping: J Ĵ⁻¹ stays positive definite,
    scaled.
    """
    J, g = jacobian(seed, np.array([1.0, 0.1, 1 / condition])), gradient_of(seed)
    v = law(J, g, 2.0, LIMIT, FAST).v
    assert (g) @ (J @ v) < 0


@given(seeds, st.floats(1e-6, 0.49 * LIMIT), st.sampled_from([False, True]))
def test_the_condition_does_not_depend_on_the_unit_of_length(seed, condition, in_metres):
    J = jacobian(seed, np.array([1.0, 0.5, 1 / max(condition, 2.0)])) * (
        1000.0 if in_metres else 1.0
    )
    found = law(J, np.ones(3), 1.0, LIMIT, FAST).condition
    assert found == pytest.approx(max(condition, 2.0), rel=1e-6)


@given(seeds, conditions, st.sampled_from([False, True]))
def test_equation_33_the_potential_falls_all_the_way_to_zero_and_the_error_with_it(
    seed, condition, printed
):
    """ẏ = J v with Ĵ = J is ẏ = -k ∂V/∂y."""
    J, gain, dt = jacobian(seed, np.array([1.0, 0.4, 1 / condition])), 2.0, 0.05
    bounds = BOUNDS[:3]
    delta = random_from(seed + 2).uniform(-3, 3, 3) * bounds
    V = potential(delta, bounds, printed)
    for _ in range(250):
        gradient = potential_gradient(delta, bounds, printed)
        v = law(J, gradient, gain, LIMIT, FAST).v
        assert np.allclose(J @ v, -gain * gradient, atol=1e-8 * bounds.max())
        delta = delta + dt * (J @ v)
        V, before = potential(delta, bounds, printed), V
        assert before > V or before < 1e-12
    assert np.all(np.abs(delta) < 1e-2 * bounds)


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 6), st.booleans())
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
        {"features": "lines"},
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
