"""Numbers of a study: each method under each condition, and its paired comparison with the first.

Pairs share the scene and the noise.
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
    Booleans,
    Interval,
    estimate_fraction,
    estimate_fraction_difference,
    estimate_median_difference,
    estimate_quantile,
    estimate_root_mean_square,
)


@dataclass(frozen=True, eq=False)
class Group:
    """Runs of one method under one condition.

    Parameters
    ----------
    method : str
        Name of the method.
    condition : str
        Label of scenes, noise, latency and disturbances.
    firsts : list[int]
        Index, in the table of all runs, of the first run of each repetition.
    rows : Any
        Table of the runs, repetition by repetition.
    """

    method: str
    condition: str
    firsts: list[int]
    rows: Any

    def row_index(self, i: int) -> int:
        """Return the index of the i-th run of the group in the table of all runs."""
        count = len(self.success) // len(self.firsts)
        return self.firsts[i // count] + i % count

    def column(self, name: str) -> Floats:
        """Return a column of numbers (n,); NaN for unknown values."""
        return self.rows[name].to_numpy().astype(np.float64)

    @property
    def engine(self) -> str:
        """Engine that made the runs."""
        return self.rows["engine"][0].as_py()

    @cached_property
    def success(self) -> Booleans:
        """Success of each run (n,)."""
        return self.rows["success"].to_numpy()

    @cached_property
    def first_within(self) -> Floats:
        """Time until first within 1 mm (n,), s; inf for a run that never was."""
        times = self.column("time_to_1mm_s")
        return np.where(np.isnan(times), np.inf, times)

    @cached_property
    def ratios(self) -> Floats:
        """Pose error divided by the bound, of the runs that succeeded."""
        bound = self.column("bound_mm")
        has_ratio = self.success & (bound > 0.0)
        return self.column("pose_error_mm")[has_ratio] / bound[has_ratio]

    @property
    def stops(self) -> list[tuple[str, int]]:
        """Causes of first stops with their counts, the most frequent first."""
        return Counter(name for name in self.rows["stop"].to_pylist() if name).most_common()


@dataclass(frozen=True)
class Summary:
    """Numbers of a method under a condition.

    Parameters
    ----------
    method : str
        Name of the method.
    condition : str
        Label of the condition.
    engine : str
        Engine that made the runs.
    runs : int
        Number of runs.
    success : Interval
        Success rate: fraction of the runs that ended within 1 mm.
    time_median_s : Interval
        Median time until first within 1 mm, s; infinite for a run that never was.
    time_95_s : Interval
        95 % quantile of that time, s.
    pose_median_mm : Interval
        Median pose error of all runs, mm.
    pose_95_mm : Interval
        95 % quantile of the pose error, mm.
    ratio_median : Interval
        Median of pose error divided by Cramér-Rao bound, of the runs that succeeded.
    ratio_rms : Interval
        Root mean square of that ratio.
    unnoticed_99_mm : Interval
        99 % quantile of the growth of the true error in SERVO without a cause, mm.
    unnoticed_worst_mm : float
        Largest growth, mm.
    stops : dict[str, int]
        Number of first stops by cause.
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
    """Paired comparison of a method with the first one, in the same scenes with the same noise.

    Parameters
    ----------
    method : str
        Name of the method.
    beside : str
        Name of the first method.
    condition : str
        Label of the condition.
    pairs : int
        Number of pairs.
    success : Interval
        Difference of the success rates.
    time_s : Interval
        Median difference of the times until first within 1 mm, s; pairs in which at least one was.
    pose_mm : Interval
        Median difference of the pose errors, mm; pairs in which both succeeded.
    """

    method: str
    beside: str
    condition: str
    pairs: int
    success: Interval
    time_s: Interval
    pose_mm: Interval


def group_runs(plan: StudyPlan, table: Any) -> list[Group]:
    """Group the rows of a study by condition and method."""
    first_rows: dict[tuple[str, str], list[int]] = {}
    for i, cell in enumerate(plan.cells):
        first_rows.setdefault((cell.condition, cell.method), []).append(i * plan.count)
    return [
        Group(method, condition, firsts, _select_rows(table, firsts, plan.count))
        for (condition, method), firsts in first_rows.items()
    ]


def _select_rows(table: Any, firsts: list[int], count: int) -> Any:
    """Return the `count` rows that begin at each of the indices `firsts`, as one table."""
    import pyarrow as pa

    arrow: Any = pa
    return arrow.concat_tables([table.slice(first, count) for first in firsts]).combine_chunks()


def summarise(group: Group) -> Summary:
    """Return the numbers of a method under a condition."""
    time, pose, runs = group.first_within, group.column("pose_error_mm"), len(group.success)
    unnoticed = group.column("unnoticed_mm")
    return Summary(
        method=group.method,
        condition=group.condition,
        engine=group.engine,
        runs=runs,
        success=estimate_fraction(int(group.success.sum()), runs),
        time_median_s=estimate_quantile(time, 0.5, 0.0),
        time_95_s=estimate_quantile(time, 0.95, 0.0),
        pose_median_mm=estimate_quantile(pose, 0.5, 0.0),
        pose_95_mm=estimate_quantile(pose, 0.95, 0.0),
        ratio_median=estimate_quantile(group.ratios, 0.5, 0.0),
        ratio_rms=estimate_root_mean_square(group.ratios),
        unnoticed_99_mm=estimate_quantile(unnoticed, 0.99, 0.0),
        unnoticed_worst_mm=float(unnoticed.max()),
        stops=dict(group.stops),
    )


def compare_with_first(groups: list[Group]) -> Iterator[PairedComparison]:
    """Compare every method with the first one of its condition."""
    baselines: dict[str, Group] = {}
    for group in groups:
        first = baselines.setdefault(group.condition, group)
        if first is not group:
            yield compare(group, first)


def compare(group: Group, baseline: Group) -> PairedComparison:
    """Compare two methods under the same condition, minus the baseline."""
    both_succeeded = group.success & baseline.success
    poses = (runs.column("pose_error_mm")[both_succeeded] for runs in (group, baseline))
    return PairedComparison(
        method=group.method,
        beside=baseline.method,
        condition=group.condition,
        pairs=len(group.success),
        success=estimate_fraction_difference(group.success, baseline.success),
        time_s=estimate_median_difference(group.first_within, baseline.first_within),
        pose_mm=estimate_median_difference(*poses),
    )
