"""Estimates with 95 % confidence intervals for the data of studies.

The methods are valid for success rates near 0 and 1, for times of events that never happen (inf),
and for errors with long tails.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rcmservo.interfaces import Floats

STATS: Any = stats
"""SciPy's statistics as `Any`, because they have no type annotations."""

Booleans = NDArray[np.bool_]

CONFIDENCE = 0.95
"""Confidence level of every interval."""


class Interval(NamedTuple):
    """Estimate with its 95 % confidence interval.

    Parameters
    ----------
    value : float
        Estimate.
    low : float
        Lower end of the interval.
    high : float
        Upper end of the interval.
    """

    value: float
    low: float
    high: float

    def __format__(self, form: str) -> str:
        """Return estimate and interval as text; an infinite estimate is "never"."""
        value = "never" if math.isinf(self.value) else format_finite(self.value, form)
        high = "∞" if math.isinf(self.high) else format_finite(self.high, form)
        return f"{value} ({format_finite(self.low, form)} to {high})"


def format_finite(value: float, form: str = ".2f") -> str:
    """Return a number as text; a dash for NaN and infinity."""
    return format(value, form) if math.isfinite(value) else "–"


UNKNOWN_INTERVAL = Interval(np.nan, np.nan, np.nan)


def estimate_fraction(count: int, of: int) -> Interval:
    """Return a fraction with Wilson's score interval (J. Am. Stat. Assoc. 22, 1927)."""
    low, high = STATS.binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(count / of, float(low), float(high))


def estimate_quantile(values: Floats, p: float, least: float = -np.inf) -> Interval:
    """Return a quantile with its distribution-free interval between order statistics.

    Parameters
    ----------
    values : Floats
        Sample (n,); inf for an event that never happened.
    p : float
        Fraction of the values below the quantile.
    least : float
        Lower bound of all values: the lower end of the interval if the sample is too small for one.
        The upper end is then inf.
    """
    n, ordered = len(values), np.sort(values)
    if n == 0:
        return UNKNOWN_INTERVAL
    ends = STATS.binom.ppf([(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0], n, p)
    low, high = int(ends[0]) - 1, int(ends[1])
    return Interval(
        _find_quantile(ordered, p * n),
        float(ordered[low]) if low >= 0 else least,
        float(ordered[high]) if high < n else np.inf,
    )


def _find_quantile(ordered: Floats, count: float) -> float:
    """Return the value with `count` sorted values up to it.

    For an integer count it is the mean of two neighbours, without a neighbour that is infinite.
    """
    whole = round(count)
    if abs(count - whole) > 1e-9:
        return float(ordered[int(count)])
    both = ordered[max(whole - 1, 0) : whole + 1]
    known = both[np.isfinite(both)]
    if len(known):
        return float(known.mean())
    return float(both[0]) if both[0] == both[-1] else np.nan


def estimate_root_mean_square(values: Floats) -> Interval:
    """Return the root mean square of values (n,) with its interval.

    The interval is that of Student's t for the logarithm of the mean square; 0 to inf for n = 1.
    """
    n, squares = len(values), values**2
    if n == 0:
        return UNKNOWN_INTERVAL
    mean = float(squares.mean())
    if n == 1 or mean == 0.0:
        return Interval(np.sqrt(mean), 0.0, np.inf)
    spread = float(squares.std(ddof=1)) / (mean * np.sqrt(n))
    ratio = np.exp(0.5 * float(STATS.t.ppf((1.0 + CONFIDENCE) / 2.0, n - 1)) * spread)
    return Interval(np.sqrt(mean), np.sqrt(mean) / ratio, np.sqrt(mean) * ratio)


def estimate_fraction_difference(one: Booleans, other: Booleans) -> Interval:
    """Return the difference of two fractions over paired booleans (n,), `one` minus `other`.

    The interval is that of A. Agresti and Y. Min, Biostatistics 6, 2005: it adds half a pair to
    each of the four cases, so that it is not empty if the two never differ.
    """
    gained, lost, n = int((one & ~other).sum()), int((~one & other).sum()), len(one)
    b, c, m = gained + 0.5, lost + 0.5, n + 2.0
    middle = (b - c) / m
    spread = float(STATS.norm.ppf((1.0 + CONFIDENCE) / 2.0)) * np.sqrt(b + c - (b - c) ** 2 / m) / m
    return Interval((gained - lost) / n, max(middle - spread, -1.0), min(middle + spread, 1.0))


def estimate_median_difference(one: Floats, other: Floats) -> Interval:
    """Return the median of `one` − `other` over pairs (n,) with its interval.

    Pairs in which both values are infinite are ignored.
    """
    known = np.isfinite(one) | np.isfinite(other)
    return estimate_quantile(one[known] - other[known], 0.5)
