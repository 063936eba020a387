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


def estimate_quantile(values: Floats, p: float, lower_bound: float = -np.inf) -> Interval:
    """Return a quantile with its distribution-free interval between order statistics.

    Parameters
    ----------
    values : Floats
        Sample (n,); inf for an event that never happened.
    p : float
        Fraction of the values below the quantile.
    lower_bound : float
        Lower bound of all values: the lower end of the interval if the sample is too small for one.
        The upper end is then inf.
    """
    n, ordered = len(values), np.sort(values)
    if n == 0:
        return UNKNOWN_INTERVAL
    counts = STATS.binom.ppf([(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0], n, p)
    low_index, high_index = int(counts[0]) - 1, int(counts[1])
    low = float(ordered[low_index]) if low_index >= 0 else lower_bound
    high = float(ordered[high_index]) if high_index < n else np.inf
    return Interval(_find_quantile(ordered, p * n), low, high)


def _find_quantile(ordered: Floats, count: float) -> float:
    """Return the value with `count` sorted values up to it.

    For an integer count it is the mean of two neighbours, without a neighbour that is infinite.
    """
    integer_count = round(count)
    if abs(count - integer_count) > 1e-9:
        return float(ordered[int(count)])
    neighbours = ordered[max(integer_count - 1, 0) : integer_count + 1]
    finite_neighbours = neighbours[np.isfinite(neighbours)]
    if len(finite_neighbours):
        return float(finite_neighbours.mean())
    return float(neighbours[0]) if neighbours[0] == neighbours[-1] else np.nan


def estimate_root_mean_square(values: Floats) -> Interval:
    """Return the root mean square of values (n,) with its interval.

    The interval is that of Student's t for the logarithm of the mean square; 0 to inf for n = 1.
    """
    n, squares = len(values), values**2
    if n == 0:
        return UNKNOWN_INTERVAL
    mean_square = float(squares.mean())
    rms = np.sqrt(mean_square)
    if n == 1 or mean_square == 0.0:
        return Interval(rms, 0.0, np.inf)
    log_deviation = float(squares.std(ddof=1)) / (mean_square * np.sqrt(n))
    ratio = np.exp(0.5 * float(STATS.t.ppf((1.0 + CONFIDENCE) / 2.0, n - 1)) * log_deviation)
    return Interval(rms, rms / ratio, rms * ratio)


def estimate_fraction_difference(success: Booleans, baseline: Booleans) -> Interval:
    """Return the difference of two fractions over paired booleans (n,), `success` minus `baseline`.

    The interval is that of A. Agresti and Y. Min, Biostatistics 6, 2005: it adds half a pair to
    each of the four cases, so that it is not empty if the two never differ.
    """
    gained, lost = int((success & ~baseline).sum()), int((~success & baseline).sum())
    b, c, m = gained + 0.5, lost + 0.5, len(success) + 2.0
    middle, z = (b - c) / m, float(STATS.norm.ppf((1.0 + CONFIDENCE) / 2.0))
    spread = z * np.sqrt(b + c - (b - c) ** 2 / m) / m
    difference = (gained - lost) / len(success)
    return Interval(difference, max(middle - spread, -1.0), min(middle + spread, 1.0))


def estimate_median_difference(values: Floats, baseline: Floats) -> Interval:
    """Return the median of `values` − `baseline` over pairs (n,) with its interval.

    Pairs in which both values are infinite are ignored.
    """
    has_finite = np.isfinite(values) | np.isfinite(baseline)
    return estimate_quantile(values[has_finite] - baseline[has_finite], 0.5)
