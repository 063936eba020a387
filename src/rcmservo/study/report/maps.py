"""Where a method converges: the share of its runs that succeed, by two things of the scene, in bins
that hold about as many runs each.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.study.report.statistics import Flags, Interval, share
from rcmservo.study.report.summary import Group

BINS = 5
LEAST = 10
"""Runs of a cell on an average, below which there are fewer bins."""


class MapAxis(NamedTuple):
    """A column that maps are drawn over.

    Parameters
    ----------
    column : str
        Of the rows.
    words : str
        With its unit.
    """

    column: str
    words: str


AXES = (
    (
        MapAxis("condition", "condition of the scaled J, the largest on the way"),
        MapAxis("start_error_mm", "mm to go"),
    ),
    (
        MapAxis("rcm_depth", "depth of the RCM before the camera, in units of marker 1's"),
        MapAxis("distance_mm", "mm from the camera to marker 1"),
    ),
)
"""The maps of a report: down, and across."""


@dataclass(frozen=True)
class Map:
    """Shares by rows and columns.

    Parameters
    ----------
    down : MapAxis
        What its rows go by.
    across : MapAxis
        What its columns go by.
    rows : list[str]
        Ranges of `down`.
    columns : list[str]
        Ranges of `across`.
    cells : list[list[tuple[int, Interval] or None]]
        Runs, and the share of them that succeeded; None where there are no runs.
    """

    down: MapAxis
    across: MapAxis
    rows: list[str]
    columns: list[str]
    cells: list[list[tuple[int, Interval] | None]]

    @property
    def divides(self) -> bool:
        """Whether there is more than one cell, which has the share of all runs."""
        return len(self.rows) * len(self.columns) > 1


def map_of(group: Group, down: MapAxis, across: MapAxis) -> Map:
    """The map of a group."""
    values = group.column(down.column), group.column(across.column)
    count = int(np.clip(np.sqrt(len(group.success) / LEAST), 1, BINS))
    edges = [_edges(one, count) for one in values]
    places = [np.digitize(one, edge[1:-1]) for one, edge in zip(values, edges, strict=True)]
    cells = [
        [
            _cell(group.success[(places[0] == i) & (places[1] == j)])
            for j in range(len(edges[1]) - 1)
        ]
        for i in range(len(edges[0]) - 1)
    ]
    return Map(down, across, _ranges(edges[0]), _ranges(edges[1]), cells)


def _edges(values: Floats, count: int) -> Floats:
    """Ends of bins that hold about as many values each; infinite ones have a bin of their own."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.array([np.inf, np.inf])
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, count + 1)))
    edges = edges if len(edges) > 1 else np.repeat(edges, 2)
    if len(known) == len(values):
        return edges
    return np.array([*edges[:-1], np.nextafter(edges[-1], np.inf), np.inf])


def _ranges(edges: Floats) -> list[str]:
    ends = [f"{end:.3g}" if np.isfinite(end) else "∞" for end in edges]
    return [a if a == b else b if b == "∞" else f"{a} to {b}" for a, b in pairwise(ends)]


def _cell(success: Flags) -> tuple[int, Interval] | None:
    count = len(success)
    return (count, share(int(success.sum()), count)) if count else None
