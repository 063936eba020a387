"""Estimates with 95 % confidence intervals for the data of studies.

The methods are valid for success rates near 0 and 1, for times of events that never happen (inf),
and for errors with long tails.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from rcmservo.interfaces import Floats

SPECIAL: Any = special
"""Special functions; `scipy.stats`, which wraps them, takes a second to import."""
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
    fraction, z = count / of, compute_normal_quantile((1.0 + CONFIDENCE) / 2.0)
    denominator = 2.0 * (of + z**2)
    center = (2.0 * of * fraction + z**2) / denominator
    reach = z / denominator * math.sqrt(4.0 * of * fraction * (1.0 - fraction) + z**2)
    low = 0.0 if count == 0 else center - reach
    return Interval(fraction, low, 1.0 if count == of else center + reach)


def compute_normal_quantile(p: float) -> float:
    """Return the quantile of the standard normal distribution for a probability."""
    return float(SPECIAL.ndtri(p))


def compute_binomial_quantile(p: float, n: int, success: float) -> int:
    """Return the smallest count of successes in n trials whose distribution function reaches p."""
    count = math.ceil(SPECIAL.bdtrik(p, n, success))
    below = max(count - 1, 0)
    return below if SPECIAL.bdtr(below, n, success) >= p else count


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
    low_index = compute_binomial_quantile((1.0 - CONFIDENCE) / 2.0, n, p) - 1
    high_index = compute_binomial_quantile((1.0 + CONFIDENCE) / 2.0, n, p)
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
    ratio = np.exp(0.5 * float(SPECIAL.stdtrit(n - 1, (1.0 + CONFIDENCE) / 2.0)) * log_deviation)
    return Interval(rms, rms / ratio, rms * ratio)


def estimate_fraction_difference(success: Booleans, baseline: Booleans) -> Interval:
    """Return the difference of two fractions over paired booleans (n,), `success` minus `baseline`.

    The interval is that of A. Agresti and Y. Min, Biostatistics 6, 2005: it adds half a pair to
    each of the four cases, so that it is not empty if the two never differ.
    """
    gained, lost = int((success & ~baseline).sum()), int((~success & baseline).sum())
    b, c, m = gained + 0.5, lost + 0.5, len(success) + 2.0
    middle, z = (b - c) / m, compute_normal_quantile((1.0 + CONFIDENCE) / 2.0)
    spread = z * np.sqrt(b + c - (b - c) ** 2 / m) / m
    difference = (gained - lost) / len(success)
    return Interval(difference, max(middle - spread, -1.0), min(middle + spread, 1.0))


def estimate_median_difference(values: Floats, baseline: Floats) -> Interval:
    """Return the median of `values` − `baseline` over pairs (n,) with its interval.

    Pairs in which both values are infinite are ignored.
    """
    has_finite = np.isfinite(values) | np.isfinite(baseline)
    return estimate_quantile(values[has_finite] - baseline[has_finite], 0.5)
