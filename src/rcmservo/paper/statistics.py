"""Small statistics of the experiments, and the curves that show them."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from rcmservo.figures.charts import Curve, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.study.report.statistics import Interval


def column(found: Iterable[Mapping[str, Any]], *keys: str) -> Floats:
    """Return one number of each result, found by its keys; NaN where there is none."""
    values: list[Any] = list(found)
    for key in keys:
        values = [value.get(key) for value in values]
    return np.array(values, dtype=float)


def rms(values: Floats | Sequence[float]) -> float:
    """Return the root mean square."""
    return math.sqrt(float(np.mean(np.square(values))))


def median(values: Floats | Sequence[float]) -> float:
    """Return the median; NaN, which no claim accepts, of nothing."""
    return float(np.median(values)) if len(values) else math.nan


def finite(values: Floats) -> Floats:
    """Return the finite ones of some numbers."""
    return values[np.isfinite(values)]


def ends_of(values: Floats) -> str:
    """Return the least and the greatest number as text."""
    return f"{values.min():.2f} to {values.max():.2f}"


def fraction(flags: Iterable[bool]) -> float:
    """Return the fraction that is true."""
    return float(np.mean(list(flags)))


def percent(one: Interval) -> Interval:
    """Return a fraction in %."""
    return Interval(*(100.0 * number for number in one))


def bars(intervals: Sequence[Interval], style: int = 0, shift: float = 0.0) -> Curve:
    """Return a line along each interval, `shift` to the right of its group."""
    x = [place + shift for place in range(len(intervals)) for _ in range(3)]
    y = [end for one in intervals for end in (one.low, one.high, math.nan)]
    return make_curve("", x, y, style)


def marks(groups: Sequence[Sequence[float] | Floats], label: str = "", style: int = 0) -> Curve:
    """Return one mark for each number, spread about the place of its group."""
    x = [
        place + 0.4 * ((i + 0.5) / len(group) - 0.5)
        for place, group in enumerate(groups)
        for i in range(len(group))
    ]
    return make_curve(label, x, [value for group in groups for value in group], style, marks=True)


def seed_marks(groups: Sequence[Floats], label: str, style: int) -> Curve:
    """Return one mark for each seed, to the right of its group."""
    x = [
        place + 0.22 * style + 0.02 * i - 0.18
        for place, group in enumerate(groups)
        for i in range(len(group))
    ]
    return make_curve(label, x, np.concatenate(groups), style, marks=True)


def mark_panels(
    labels: Mapping[str, str],
    groups: Callable[[str], Sequence[Floats]],
    categories: Iterable[str],
    log: Sequence[str] = (),
) -> list[Panel]:
    """Return a panel with one mark for each number of some groups, for every one of the labels."""
    names = list(categories)
    return [
        Panel("", label, [marks(groups(key))], log_y=key in log, categories=names)
        for key, label in labels.items()
    ]
