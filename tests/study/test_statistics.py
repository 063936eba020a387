"""Coverage of the 95 % intervals in samples like those of studies."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rcmservo.interfaces import Floats
from rcmservo.study.report.statistics import (
    Interval,
    estimate_fraction,
    estimate_fraction_difference,
    estimate_median_difference,
    estimate_quantile,
    estimate_root_mean_square,
)

TIMES = st.one_of(st.floats(0.0, 15.0), st.just(np.inf))
"""Time of an event, s; inf if it never happens."""

SAMPLES = 1000
"""Number of intervals whose coverage has a standard deviation of 0.7 %."""


def coverage(truth: float, sample: Callable[[np.random.Generator], Interval], count: int) -> float:
    """Return the fraction of intervals that contain the true value."""
    random = np.random.default_rng(1)
    intervals = [sample(random) for _ in range(count)]
    return float(np.mean([interval.low <= truth <= interval.high for interval in intervals]))


@pytest.mark.parametrize("p", [0.5, 0.9, 0.99])
def test_the_interval_of_a_fraction_has_nominal_coverage(p: float) -> None:
    """The coverage of Wilson's interval varies with p and n; its mean over n is near 95 %."""

    def sample(random: np.random.Generator) -> Interval:
        n = int(random.integers(100, 400))
        return estimate_fraction(int(random.binomial(n, p)), n)

    assert 0.93 < coverage(p, sample, SAMPLES) < 0.98


def test_a_fraction_of_0_or_1_has_an_interval() -> None:
    assert estimate_fraction(200, 200) == pytest.approx((1.0, 0.981, 1.0), abs=1e-3)
    assert estimate_fraction(0, 200) == pytest.approx((0.0, 0.0, 0.019), abs=1e-3)


@pytest.mark.parametrize("p", [0.5, 0.95])
def test_the_interval_of_a_quantile_has_nominal_coverage_for_long_tails(p: float) -> None:
    truth = float(
        np.tan(np.pi * (p - 0.5))
    )  # quantile of the Cauchy distribution, which has no mean

    def sample(random: np.random.Generator) -> Interval:
        return estimate_quantile(random.standard_cauchy(200), p)

    assert 0.94 < coverage(truth, sample, SAMPLES) < 0.985


def test_an_event_that_never_happens_is_later_than_every_time() -> None:
    times = np.array([1.0, 2.0, 3.0, np.inf, np.inf, np.inf, np.inf])
    assert (
        estimate_quantile(times, 0.5).value == np.inf and estimate_quantile(times, 0.1).value == 1.0
    )
    assert estimate_quantile(times, 0.5).low == 1.0 and estimate_quantile(times, 0.5).high == np.inf
    assert np.isnan(estimate_quantile(np.array([]), 0.5).value)


@pytest.mark.parametrize(("count", "p"), [(1, 0.5), (3, 0.5), (12, 0.5), (24, 0.95), (60, 0.99)])
def test_the_interval_of_a_quantile_has_nominal_coverage_for_small_samples(
    count: int, p: float
) -> None:
    """Smallest and largest value are no ends of an interval of a small sample.

    Its coverage would be too low, and one scene could make two methods differ.
    """

    def sample(random: np.random.Generator) -> Interval:
        return estimate_quantile(random.uniform(size=count), p, 0.0)

    assert coverage(p, sample, SAMPLES) > 0.94


def test_fewer_than_six_pairs_show_no_difference() -> None:
    for count in range(1, 6):
        difference = estimate_median_difference(np.full(count, 2.0), np.ones(count))
        assert difference == (1.0, -np.inf, np.inf)
    assert estimate_median_difference(np.full(6, 2.0), np.ones(6)).low == 1.0
    assert estimate_root_mean_square(np.ones(1)) == (1.0, 0.0, np.inf)


@pytest.mark.parametrize("count", [6, 20, 200])
def test_the_interval_of_a_root_mean_square_covers_it_and_is_rarely_below(count: int) -> None:
    """The samples are lengths of Gaussian errors in space, as of an efficient method.

    An interval below the true value too often would place such a method below the bound.
    """

    def sample(random: np.random.Generator) -> Interval:
        return estimate_root_mean_square(np.linalg.norm(random.standard_normal((count, 3)), axis=1))

    def below(random: np.random.Generator) -> Interval:
        return sample(random)._replace(low=0.0)

    assert coverage(np.sqrt(3.0), sample, SAMPLES) > 0.93
    assert coverage(np.sqrt(3.0), below, SAMPLES) > 0.945


def test_a_quantile_is_a_sample_value_and_a_median_is_the_mean_of_two() -> None:
    inf, values = np.inf, np.array([1.0, 2.0, 4.0, 8.0])
    assert (
        estimate_quantile(values, 0.5).value == 3.0
        and estimate_quantile(values[:3], 0.5).value == 2.0
    )
    assert estimate_quantile(np.r_[np.arange(190.0), np.full(10, inf)], 0.95).value == 189.0
    assert estimate_quantile(np.r_[np.arange(189.0), np.full(11, inf)], 0.95).value == inf
    assert estimate_quantile(np.array([-inf, inf]), 0.5).value != 0.0


@given(
    one=arrays(float, 9, elements=TIMES),
    other=arrays(float, 9, elements=TIMES),
    count=st.integers(1, 9),
)
def test_exchanging_the_methods_changes_only_the_sign_of_the_difference(
    one: Floats, other: Floats, count: int
) -> None:
    forward, reverse = (
        estimate_median_difference(a[:count], b[:count]) for a, b in ((one, other), (other, one))
    )
    np.testing.assert_array_equal(forward, (-reverse.value, -reverse.high, -reverse.low))


@pytest.mark.parametrize(("gained", "lost"), [(0.02, 0.02), (0.1, 0.0), (0.05, 0.01)])
def test_the_interval_of_a_difference_of_paired_fractions_has_nominal_coverage(
    gained: float, lost: float
) -> None:
    def sample(random: np.random.Generator) -> Interval:
        chance = random.random(200)
        one, other = chance < gained, (gained <= chance) & (chance < gained + lost)
        both = random.random(200) < 0.8
        return estimate_fraction_difference(one | (both & ~other), other | (both & ~one))

    assert 0.93 < coverage(gained - lost, sample, SAMPLES) < 0.985


def test_equal_pairs_still_have_an_interval_around_zero() -> None:
    same = np.ones(200, bool)
    value, low, high = estimate_fraction_difference(same, same)
    assert value == 0.0 and low < -0.005 and high > 0.005
    assert estimate_fraction_difference(same[:9], ~same[:9]).high == 1.0
    assert estimate_fraction_difference(~same[:9], same[:9]).low == -1.0


def test_pairs_resolve_smaller_differences_than_two_samples() -> None:
    """The difference is a tenth of the variation between scenes."""
    random = np.random.default_rng(0)
    scenes = random.exponential(1.0, 200)
    one, other = scenes + 0.1 + 0.01 * random.standard_normal(200), scenes
    paired, unpaired = estimate_median_difference(one, other), estimate_quantile(one, 0.5)
    assert paired.low > 0.09 and paired.high < 0.11
    assert unpaired.low < np.median(other) < unpaired.high


def test_a_pair_counts_if_at_least_one_time_is_finite() -> None:
    inf = np.inf
    one, other = np.array([1.0, inf, inf, 2.0]), np.array([2.0, 1.0, inf, 4.0])
    assert sort_known_differences(one, other).tolist() == [-2.0, -1.0, inf]
    assert estimate_median_difference(one, other).value == -1.0


def sort_known_differences(one: Floats, other: Floats) -> Floats:
    is_known = np.isfinite(one) | np.isfinite(other)
    return np.sort(one[is_known] - other[is_known])
