"""Convergence maps: success rate of a method over two properties of the scene.

The bins of a property hold about the same number of runs.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.study.report.statistics import Booleans, Interval, estimate_fraction
from rcmservo.study.report.summary import Group

MAX_BINS = 5
"""Largest number of bins of a property."""
MIN_RUNS_PER_CELL = 10
"""Mean number of runs of a cell, below which there are fewer bins."""


class MapAxis(NamedTuple):
    """Column of the rows that is an axis of a map.

    Parameters
    ----------
    column : str
        Name of the column.
    label : str
        Label with unit.
    """

    column: str
    label: str


MAP_AXES = (
    (
        MapAxis("condition", "largest condition number of the scaled J on the path"),
        MapAxis("start_error_mm", "initial error, mm"),
    ),
    (
        MapAxis("rcm_depth", "depth of the RCM divided by that of marker 1"),
        MapAxis("distance_mm", "distance from the camera to marker 1, mm"),
    ),
)
"""Axes of the maps of a report: vertical and horizontal."""


@dataclass(frozen=True)
class ConvergenceMap:
    """Success rates in bins of two properties of the scene.

    Parameters
    ----------
    down : MapAxis
        Property of the rows.
    across : MapAxis
        Property of the columns.
    rows : list[str]
        Labels of the bins of `down`.
    columns : list[str]
        Labels of the bins of `across`.
    cells : list[list[tuple[int, Interval] or None]]
        Number of runs and their success rate; None without runs.
    """

    down: MapAxis
    across: MapAxis
    rows: list[str]
    columns: list[str]
    cells: list[list[tuple[int, Interval] | None]]

    @property
    def has_several_cells(self) -> bool:
        """True for more than one cell; a single cell repeats the success rate of all runs."""
        return len(self.rows) * len(self.columns) > 1


def make_map(group: Group, down: MapAxis, across: MapAxis) -> ConvergenceMap:
    """Return the map of a group of runs."""
    values = group.column(down.column), group.column(across.column)
    bin_count = int(np.clip(np.sqrt(len(group.success) / MIN_RUNS_PER_CELL), 1, MAX_BINS))
    row_edges, column_edges = (_make_edges(column, bin_count) for column in values)
    row_bins = np.digitize(values[0], row_edges[1:-1])
    column_bins = np.digitize(values[1], column_edges[1:-1])
    rows, columns = _make_labels(row_edges), _make_labels(column_edges)
    cells = [
        [
            _make_cell(group.success[(row_bins == i) & (column_bins == j)])
            for j in range(len(columns))
        ]
        for i in range(len(rows))
    ]
    return ConvergenceMap(down, across, rows, columns, cells)


def _make_edges(values: Floats, count: int) -> Floats:
    """Return the edges of bins with about equal counts; infinite values have a bin of their own."""
    finite_values = values[np.isfinite(values)]
    if not len(finite_values):
        return np.array([np.inf, np.inf])
    edges = np.unique(np.quantile(finite_values, np.linspace(0.0, 1.0, count + 1)))
    edges = edges if len(edges) > 1 else np.repeat(edges, 2)
    if len(finite_values) == len(values):
        return edges
    return np.array([*edges[:-1], np.nextafter(edges[-1], np.inf), np.inf])


def _make_labels(edges: Floats) -> list[str]:
    """Return the label of every bin between two edges."""
    texts = [f"{edge:.3g}" if np.isfinite(edge) else "∞" for edge in edges]
    return [a if a == b else b if b == "∞" else f"{a} to {b}" for a, b in pairwise(texts)]


def _make_cell(success: Booleans) -> tuple[int, Interval] | None:
    """Return number and success rate of the runs in a cell; None without runs."""
    count = len(success)
    return (count, estimate_fraction(int(success.sum()), count)) if count else None
