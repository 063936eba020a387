"""Intervals of 95 % hold what they promise, in samples like those of studies."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rcmservo.interfaces import Floats
from rcmservo.study.report.statistics import (
    Interval,
    median_difference,
    quantile,
    root_mean_square,
    share,
    share_difference,
)

TIMES = st.one_of(st.floats(0.0, 15.0), st.just(np.inf))
"""s until something came, or never."""

SAMPLES = 1000
"""The share of intervals that hold the truth is known to 0.7 %."""


def held(truth: float, sample: Callable[[np.random.Generator], Interval], count: int) -> float:
    """The share of intervals that hold the truth."""
    random = np.random.default_rng(1)
    intervals = [sample(random) for _ in range(count)]
    return float(np.mean([one.low <= truth <= one.high for one in intervals]))


@pytest.mark.parametrize("p", [0.5, 0.9, 0.99])
def test_the_interval_of_a_share_holds_it(p: float) -> None:
    """Wilson's is above or below 95 % for single p and n; the mean over n is near it."""

    def sample(random: np.random.Generator) -> Interval:
        n = int(random.integers(100, 400))
        return share(int(random.binomial(n, p)), n)

    assert 0.93 < held(p, sample, SAMPLES) < 0.98


def test_a_share_of_all_or_none_still_has_an_interval() -> None:
    assert share(200, 200) == pytest.approx((1.0, 0.981, 1.0), abs=1e-3)
    assert share(0, 200) == pytest.approx((0.0, 0.0, 0.019), abs=1e-3)


@pytest.mark.parametrize("p", [0.5, 0.95])
def test_the_interval_of_a_quantile_holds_it_whatever_the_tail(p: float) -> None:
    truth = float(np.tan(np.pi * (p - 0.5)))  # of Cauchy's distribution, which has no mean

    def sample(random: np.random.Generator) -> Interval:
        return quantile(random.standard_cauchy(200), p)

    assert 0.94 < held(truth, sample, SAMPLES) < 0.985


def test_what_never_came_is_beyond_every_time() -> None:
    times = np.array([1.0, 2.0, 3.0, np.inf, np.inf, np.inf, np.inf])
    assert quantile(times, 0.5).value == np.inf and quantile(times, 0.1).value == 1.0
    assert quantile(times, 0.5).low == 1.0 and quantile(times, 0.5).high == np.inf
    assert np.isnan(quantile(np.array([]), 0.5).value)


@pytest.mark.parametrize(("count", "p"), [(1, 0.5), (3, 0.5), (12, 0.5), (24, 0.95), (60, 0.99)])
def test_the_interval_of_a_quantile_holds_it_in_few_values(count: int, p: float) -> None:
    """The least and the greatest of a few values are no ends: their interval holds the truth too
    seldom, and two methods would be told apart by one scene.
    """

    def sample(random: np.random.Generator) -> Interval:
        return quantile(random.uniform(size=count), p, 0.0)

    assert held(p, sample, SAMPLES) > 0.94


def test_a_few_pairs_tell_nothing_apart() -> None:
    for count in range(1, 6):
        one = median_difference(np.full(count, 2.0), np.ones(count))
        assert one == (1.0, -np.inf, np.inf)
    assert median_difference(np.full(6, 2.0), np.ones(6)).low == 1.0
    assert root_mean_square(np.ones(1)) == (1.0, 0.0, np.inf)


@pytest.mark.parametrize("count", [6, 20, 200])
def test_the_interval_of_a_root_mean_square_holds_it_and_does_not_lie_below(count: int) -> None:
    """Of the lengths of Gaussian errors in space, as an efficient method has them. One that ended
    below the truth too often would have it beat the bound.
    """

    def sample(random: np.random.Generator) -> Interval:
        return root_mean_square(np.linalg.norm(random.standard_normal((count, 3)), axis=1))

    def below(random: np.random.Generator) -> Interval:
        return sample(random)._replace(low=0.0)

    assert held(np.sqrt(3.0), sample, SAMPLES) > 0.93
    assert held(np.sqrt(3.0), below, SAMPLES) > 0.945


def test_a_quantile_is_where_so_many_are_and_a_median_in_the_middle() -> None:
    inf, one = np.inf, np.array([1.0, 2.0, 4.0, 8.0])
    assert quantile(one, 0.5).value == 3.0 and quantile(one[:3], 0.5).value == 2.0
    assert quantile(np.r_[np.arange(190.0), np.full(10, inf)], 0.95).value == 189.0
    assert quantile(np.r_[np.arange(189.0), np.full(11, inf)], 0.95).value == inf
    assert quantile(np.array([-inf, inf]), 0.5).value != 0.0


@given(
    one=arrays(float, 9, elements=TIMES),
    other=arrays(float, 9, elements=TIMES),
    count=st.integers(1, 9),
)
def test_which_method_stands_first_turns_the_sign_and_nothing_else(
    one: Floats, other: Floats, count: int
) -> None:
    there, back = (median_difference(a[:count], b[:count]) for a, b in ((one, other), (other, one)))
    np.testing.assert_array_equal(there, (-back.value, -back.high, -back.low))


@pytest.mark.parametrize(("gained", "lost"), [(0.02, 0.02), (0.1, 0.0), (0.05, 0.01)])
def test_the_interval_of_a_difference_of_paired_shares_holds_it(gained: float, lost: float) -> None:
    def sample(random: np.random.Generator) -> Interval:
        chance = random.random(200)
        one, other = chance < gained, (gained <= chance) & (chance < gained + lost)
        both = random.random(200) < 0.8
        return share_difference(one | (both & ~other), other | (both & ~one))

    assert 0.93 < held(gained - lost, sample, SAMPLES) < 0.985


def test_pairs_that_never_differed_do_not_show_that_none_would() -> None:
    same = np.ones(200, bool)
    value, low, high = share_difference(same, same)
    assert value == 0.0 and low < -0.005 and high > 0.005
    assert share_difference(same[:9], ~same[:9]).high == 1.0
    assert share_difference(~same[:9], same[:9]).low == -1.0


def test_pairs_tell_more_than_two_samples_do() -> None:
    """A difference that is a tenth of what scenes differ by."""
    random = np.random.default_rng(0)
    scenes = random.exponential(1.0, 200)
    one, other = scenes + 0.1 + 0.01 * random.standard_normal(200), scenes
    paired, apart = median_difference(one, other), quantile(one, 0.5)
    assert paired.low > 0.09 and paired.high < 0.11
    assert apart.low < np.median(other) < apart.high


def test_a_pair_counts_where_one_of_its_times_came() -> None:
    inf = np.inf
    one, other = np.array([1.0, inf, inf, 2.0]), np.array([2.0, 1.0, inf, 4.0])
    assert known(one, other).tolist() == [-2.0, -1.0, inf]
    assert median_difference(one, other).value == -1.0


def known(one: Floats, other: Floats) -> Floats:
    both = np.isfinite(one) | np.isfinite(other)
    return np.sort(one[both] - other[both])
