"""A study in numbers: every method under every condition, and every method beside the first one, in
the same scenes with the same noise.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.report.statistics import (
    Flags,
    Interval,
    median_difference,
    quantile,
    root_mean_square,
    share,
    share_difference,
)


@dataclass(frozen=True, eq=False)
class Group:
    """All runs of one method under one condition.

    Parameters
    ----------
    method : str
        Its name.
    condition : str
        Scenes, noise, latency and disturbances, in words.
    firsts : list[int]
        The row of the first run of each of its repetitions.
    rows : Any
        Its runs, repetition by repetition, as a table.
    """

    method: str
    condition: str
    firsts: list[int]
    rows: Any

    def case(self, i: int) -> int:
        """The row of its i-th run in the table of all."""
        count = len(self.success) // len(self.firsts)
        return self.firsts[i // count] + i % count

    def column(self, name: str) -> Floats:
        """A column of numbers; NaN where nothing is known."""
        return self.rows[name].to_numpy().astype(np.float64)

    @property
    def engine(self) -> str:
        return self.rows["engine"][0].as_py()

    @cached_property
    def success(self) -> Flags:
        """Of each of its runs."""
        return self.rows["success"].to_numpy()

    @cached_property
    def first_within(self) -> Floats:
        """S until first within 1 mm; inf if never."""
        times = self.column("time_to_1mm_s")
        return np.where(np.isnan(times), np.inf, times)

    @cached_property
    def ratios(self) -> Floats:
        """Pose error over the bound, of runs that arrived."""
        bound = self.column("bound_mm")
        good = self.success & (bound > 0.0)
        return self.column("pose_error_mm")[good] / bound[good]

    @property
    def stops(self) -> list[tuple[str, int]]:
        """Causes of first stops, the most frequent first."""
        counted = Counter(name for name in self.rows["stop"].to_pylist() if name)
        return counted.most_common()


@dataclass(frozen=True)
class Summary:
    """A method under a condition, in numbers.

    Parameters
    ----------
    method : str
        Its name.
    condition : str
        In words.
    engine : str
        What made the runs.
    runs : int
        How many.
    success : Interval
        Share of the runs that ended within 1 mm.
    time_median_s : Interval
        s until first within 1 mm, runs that never were counting as infinite.
    time_95_s : Interval
        The same, 95 % of the runs.
    pose_median_mm : Interval
        mm at the end, of all runs.
    pose_95_mm : Interval
        The same, 95 % of the runs.
    ratio_median : Interval
        Pose error over the Cramér-Rao bound, of the runs that succeeded.
    ratio_rms : Interval
        The same, root mean square.
    unnoticed_99_mm : Interval
        mm that the true error grew by without a word.
    unnoticed_worst_mm : float
        The most of it.
    stops : dict[str, int]
        First stops by their causes.
    """

    method: str
    condition: str
    engine: str
    runs: int
    success: Interval
    time_median_s: Interval
    time_95_s: Interval
    pose_median_mm: Interval
    pose_95_mm: Interval
    ratio_median: Interval
    ratio_rms: Interval
    unnoticed_99_mm: Interval
    unnoticed_worst_mm: float
    stops: dict[str, int]


@dataclass(frozen=True)
class PairedComparison:
    """A method beside the first one, in the same scenes with the same noise.

    Parameters
    ----------
    method : str
        Its name.
    beside : str
        The first one's.
    condition : str
        In words.
    pairs : int
        How many.
    success : Interval
        Difference of the shares that succeeded.
    time_s : Interval
        Median difference of the times until first within 1 mm, where one of them came.
    pose_mm : Interval
        Median difference of the pose errors, where both succeeded.
    """

    method: str
    beside: str
    condition: str
    pairs: int
    success: Interval
    time_s: Interval
    pose_mm: Interval


def groups(plan: StudyPlan, table: Any) -> list[Group]:
    """The rows by condition and method."""
    places: dict[tuple[str, str], list[int]] = {}
    for i, cell in enumerate(plan.cells):
        places.setdefault((cell.condition, cell.method), []).append(i * plan.count)
    return [
        Group(method, condition, firsts, _slices(table, firsts, plan.count))
        for (condition, method), firsts in places.items()
    ]


def _slices(table: Any, firsts: list[int], count: int) -> Any:
    import pyarrow as pa

    arrow: Any = pa
    return arrow.concat_tables([table.slice(first, count) for first in firsts]).combine_chunks()


def summary_of(group: Group) -> Summary:
    """The numbers of a method under a condition."""
    time, pose, runs = group.first_within, group.column("pose_error_mm"), len(group.success)
    unnoticed = group.column("unnoticed_mm")
    return Summary(
        method=group.method,
        condition=group.condition,
        engine=group.engine,
        runs=runs,
        success=share(int(group.success.sum()), runs),
        time_median_s=quantile(time, 0.5, 0.0),
        time_95_s=quantile(time, 0.95, 0.0),
        pose_median_mm=quantile(pose, 0.5, 0.0),
        pose_95_mm=quantile(pose, 0.95, 0.0),
        ratio_median=quantile(group.ratios, 0.5, 0.0),
        ratio_rms=root_mean_square(group.ratios),
        unnoticed_99_mm=quantile(unnoticed, 0.99, 0.0),
        unnoticed_worst_mm=float(unnoticed.max()),
        stops=dict(group.stops),
    )


def comparisons(found: list[Group]) -> Iterator[PairedComparison]:
    """Every method beside the first one, condition by condition."""
    base: dict[str, Group] = {}
    for group in found:
        first = base.setdefault(group.condition, group)
        if first is not group:
            yield compared(group, first)


def compared(one: Group, other: Group) -> PairedComparison:
    """One method beside another, under the same condition."""
    both = one.success & other.success
    poses = (group.column("pose_error_mm")[both] for group in (one, other))
    return PairedComparison(
        method=one.method,
        beside=other.method,
        condition=one.condition,
        pairs=len(one.success),
        success=share_difference(one.success, other.success),
        time_s=median_difference(one.first_within, other.first_within),
        pose_mm=median_difference(*poses),
    )
