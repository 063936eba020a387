"""The few statistics that claims are made of."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from rcmservo.figures.charts import Curve, curve
from rcmservo.interfaces import Floats
from rcmservo.study.told.statistics import Interval


def rms(values: Floats | Sequence[float]) -> float:
    """Root mean square of all numbers."""
    return math.sqrt(float(np.mean(np.square(values))))


def median(values: Floats | Sequence[float]) -> float:
    """The median; NaN, which no claim takes, of nothing."""
    return float(np.median(values)) if len(values) else math.nan


def share(of: Iterable[bool]) -> float:
    """How many of all are true, from 0 to 1."""
    return float(np.mean(list(of)))


def known(values: Iterable[float | None]) -> list[float]:
    """The numbers that there are."""
    return [value for value in values if value is not None]


def told(value: float, form: str = ".2f") -> str:
    """A number in a sentence; a dash where there is none."""
    return format(value, form) if math.isfinite(value) else "–"


def spread(one: Interval, form: str = ".2f") -> str:
    """A number and its interval in a sentence; an infinite time never came, and too few trials
    leave an end open."""
    value, low, high = (told(number, form) for number in one)
    value = "never" if math.isinf(one.value) else value
    return f"{value} ({low} to {'∞' if math.isinf(one.high) else high})"


def percent(one: Interval) -> Interval:
    """A share in %."""
    return Interval(*(100.0 * number for number in one))


def bars(intervals: Sequence[Interval], style: int = 0, aside: float = 0.0) -> Curve:
    """A line along each interval, `aside` of the place of its group."""
    x = [place + aside for place in range(len(intervals)) for _ in range(3)]
    y = [end for one in intervals for end in (one.low, one.high, math.nan)]
    return curve("", x, y, style)


def marks(groups: Sequence[Sequence[float | None]], label: str = "", style: int = 0) -> Curve:
    """One mark for each number, spread beside the place of its group."""
    x = [
        place + 0.4 * ((i + 0.5) / len(group) - 0.5)
        for place, group in enumerate(groups)
        for i in range(len(group))
    ]
    y = [math.nan if value is None else value for group in groups for value in group]
    return curve(label, x, y, style, marks=True)
