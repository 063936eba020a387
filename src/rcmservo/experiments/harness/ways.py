"""One thing done in several ways with every seed: the numbers of each way, side by side.

A row holds what a seed brought, by way and by key.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import median
from rcmservo.figures.charts import Curve, curve
from rcmservo.interfaces import Floats

Rows = Sequence[Mapping[str, Mapping[str, Any]]]


def numbers(rows: Rows, way: str, key: str) -> Floats:
    """One number of every row; NaN where there is none."""
    return np.array([row[way][key] for row in rows], dtype=float)


def middle(values: Floats) -> float:
    """Median of those that are finite, or NaN."""
    return median(values[np.isfinite(values)])


def middles(rows: Rows, ways: Iterable[str], key: str) -> dict[str, float]:
    """The median of every way."""
    return {way: middle(numbers(rows, way, key)) for way in ways}


def marks(rows: Rows, ways: Iterable[str], key: str) -> Curve:
    """One mark for each row, spread beside the place of its way."""
    groups = [numbers(rows, way, key) for way in ways]
    x = [
        place + 0.4 * ((i + 0.5) / len(group) - 0.5)
        for place, group in enumerate(groups)
        for i in range(len(group))
    ]
    return curve("", x, np.concatenate(groups), marks=True)
