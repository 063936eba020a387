"""Numbers with their intervals of 95 %, each by a way that holds for what studies have: shares near
0 and 1, times that never come, errors with long tails.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from rcmservo.interfaces import Floats

STATS: Any = stats
"""SciPy's without types: it has none."""

Flags = NDArray[np.bool_]

SURE = 0.95
"""Of every interval."""


class Interval(NamedTuple):
    """A number, and between what it is.

    Parameters
    ----------
    value : float
        The number.
    low : float
        The least that it is thought to be.
    high : float
        The greatest.
    """

    value: float
    low: float
    high: float

    def __format__(self, form: str) -> str:
        """Return the number and its interval as text; an infinite number never came."""
        value = "never" if math.isinf(self.value) else dashed(self.value, form)
        high = "∞" if math.isinf(self.high) else dashed(self.high, form)
        return f"{value} ({dashed(self.low, form)} to {high})"


def dashed(value: float, form: str = ".2f") -> str:
    """Return a number as text, or a dash if it is not finite."""
    return format(value, form) if math.isfinite(value) else "–"


UNKNOWN = Interval(np.nan, np.nan, np.nan)


def share(count: int, of: int) -> Interval:
    """A share, with Wilson's interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    low, high = STATS.binomtest(count, of).proportion_ci(SURE, method="wilson")
    return Interval(count / of, float(low), float(high))


def quantile(values: Floats, p: float, least: float = -np.inf) -> Interval:
    """A quantile, with the interval between order statistics, whatever the values' distribution.
    Values that never came are inf. Where the values are too few for an end of it, that is inf, or
    what no value is below, `least`.
    """
    n, ordered = len(values), np.sort(values)
    if n == 0:
        return UNKNOWN
    ends = STATS.binom.ppf([(1.0 - SURE) / 2.0, (1.0 + SURE) / 2.0], n, p)
    low, high = int(ends[0]) - 1, int(ends[1])
    return Interval(
        _at(ordered, p * n),
        float(ordered[low]) if low >= 0 else least,
        float(ordered[high]) if high < n else np.inf,
    )


def _at(ordered: Floats, count: float) -> float:
    """The value up to which there are so many: half-way to the next one where they are whole, but
    for a next one that never came.
    """
    whole = round(count)
    if abs(count - whole) > 1e-9:
        return float(ordered[int(count)])
    both = ordered[max(whole - 1, 0) : whole + 1]
    known = both[np.isfinite(both)]
    if len(known):
        return float(known.mean())
    return float(both[0]) if both[0] == both[-1] else np.nan


def root_mean_square(values: Floats) -> Interval:
    """The root mean square, with the interval that Student's t gives the logarithm of the mean
    square; from 0 to inf of a single value.
    """
    n, squares = len(values), values**2
    if n == 0:
        return UNKNOWN
    mean = float(squares.mean())
    if n == 1 or mean == 0.0:
        return Interval(np.sqrt(mean), 0.0, np.inf)
    spread = float(squares.std(ddof=1)) / (mean * np.sqrt(n))
    ratio = np.exp(0.5 * float(STATS.t.ppf((1.0 + SURE) / 2.0, n - 1)) * spread)
    return Interval(np.sqrt(mean), np.sqrt(mean) / ratio, np.sqrt(mean) * ratio)


def share_difference(one: Flags, other: Flags) -> Interval:
    """How much greater the share of `one` is than that of `other`, of pairs of booleans (n,), with
    the interval of A. Agresti and Y. Min, Biostatistics 6, 2005: half a pair more in each of the
    four cases, so that no interval is empty where the two never differed.
    """
    gained, lost, n = int((one & ~other).sum()), int((~one & other).sum()), len(one)
    b, c, m = gained + 0.5, lost + 0.5, n + 2.0
    middle = (b - c) / m
    spread = float(STATS.norm.ppf((1.0 + SURE) / 2.0)) * np.sqrt(b + c - (b - c) ** 2 / m) / m
    return Interval((gained - lost) / n, max(middle - spread, -1.0), min(middle + spread, 1.0))


def median_difference(one: Floats, other: Floats) -> Interval:
    """The median of `one` − `other` over pairs, with the interval between order statistics. A pair
    of which both never came tells nothing.
    """
    known = np.isfinite(one) | np.isfinite(other)
    return quantile(one[known] - other[known], 0.5)
