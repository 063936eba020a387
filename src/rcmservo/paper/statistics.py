"""Statistics of the experiments, and curves for their figures."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from rcmservo.figures.charts import Curve, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.study.report.statistics import Interval


def column(results: Iterable[Mapping[str, Any]], *keys: str) -> Floats:
    """Return one number of each result, addressed by nested keys; NaN if it is missing."""
    values: list[Any] = list(results)
    for key in keys:
        values = [value.get(key) for value in values]
    return np.array(values, dtype=float)


def rms(values: Floats | Sequence[float]) -> float:
    """Return the root mean square."""
    return math.sqrt(float(np.mean(np.square(values))))


def median(values: Floats | Sequence[float]) -> float:
    """Return the median; NaN for an empty sequence, which `judge` rejects."""
    return float(np.median(values)) if len(values) else math.nan


def finite(values: Floats) -> Floats:
    """Return the finite values."""
    return values[np.isfinite(values)]


def format_range(values: Floats) -> str:
    """Return the minimum and the maximum as text."""
    return f"{values.min():.2f} to {values.max():.2f}"


def fraction(flags: Iterable[bool]) -> float:
    """Return the fraction of true flags."""
    return float(np.mean(list(flags)))


def to_percent(interval: Interval) -> Interval:
    """Convert a fraction and its interval to percent."""
    return Interval(*(100.0 * number for number in interval))


def curve_per_label(
    labels: Mapping[str, str], points_of: Callable[[str], tuple[Any, Any]], marks: bool = False
) -> list[Curve]:
    """Return a curve for each label, in successive styles; `points_of(key)` returns its x and y."""
    return [
        make_curve(label, *points_of(key), style, marks)
        for style, (key, label) in enumerate(labels.items())
    ]


def interval_bars(intervals: Sequence[Interval], style: int = 0, shift: float = 0.0) -> Curve:
    """Return a vertical line along each interval, at the index of its group plus `shift`."""
    x = [index + shift for index in range(len(intervals)) for _ in range(3)]
    y = [end for interval in intervals for end in (interval.low, interval.high, math.nan)]
    return make_curve("", x, y, style)


def group_marks(
    groups: Sequence[Sequence[float] | Floats], label: str = "", style: int = 0
) -> Curve:
    """Return one mark per number, spread about the index of its group."""
    x = [
        index + 0.4 * ((i + 0.5) / len(group) - 0.5)
        for index, group in enumerate(groups)
        for i in range(len(group))
    ]
    return make_curve(label, x, [value for group in groups for value in group], style, marks=True)


def seed_marks(groups: Sequence[Floats], label: str, style: int) -> Curve:
    """Return one mark per seed, next to the index of its group; `style` separates the curves."""
    x = [
        index + 0.22 * style + 0.02 * i - 0.18
        for index, group in enumerate(groups)
        for i in range(len(group))
    ]
    return make_curve(label, x, np.concatenate(groups), style, marks=True)


def mark_panels(
    labels: Mapping[str, str],
    groups_of: Callable[[str], Sequence[Floats]],
    categories: Iterable[str],
    log: Sequence[str] = (),
) -> list[Panel]:
    """Return one panel per label, with one mark per number of `groups_of(key)`."""
    names = list(categories)
    return [
        Panel("", label, [group_marks(groups_of(key))], log_y=key in log, categories=names)
        for key, label in labels.items()
    ]
