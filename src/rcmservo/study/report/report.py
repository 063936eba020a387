"""Report of a study: an HTML page that opens without a network, and its numbers in summary.json."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.toml_json_parsing import is_table
from rcmservo.figures import charts
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.study.execution.store import REPORT_FILE, SUMMARY_FILE
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.report.html import make_data_uri, render_template
from rcmservo.study.report.maps import MAP_AXES, ConvergenceMap, make_map
from rcmservo.study.report.statistics import Interval
from rcmservo.study.report.summary import (
    Group,
    PairedComparison,
    Summary,
    compare_with_first,
    group_runs,
    summarise,
)
from rcmservo.study.row import COLUMN_MEANINGS

WORST_RUN_COUNT = 5
"""Number of worst runs of each method that the page lists."""
MAX_CURVE_STEPS = 200
"""Largest number of steps of a curve: more are not visible."""


class WorstRun(NamedTuple):
    """Run with one of the largest pose errors.

    Parameters
    ----------
    row : int
        Index of its row in runs.parquet, from 0.
    seed : int
        Seed of its scene.
    repetition : int
        Number of the noise sequence.
    pose_mm : float
        Pose error, mm.
    unnoticed_mm : float
        Growth of the error in SERVO without a cause, mm.
    stop : str
        Cause of the first stop; empty without a stop.
    """

    row: int
    seed: int
    repetition: int
    pose_mm: float
    unnoticed_mm: float
    stop: str


@dataclass(frozen=True)
class ConditionReport:
    """Section of the page about one condition.

    Parameters
    ----------
    name : str
        Label of the condition.
    summaries : list[Summary]
        Numbers of every method.
    comparisons : list[PairedComparison]
        Comparisons of the other methods with the first one.
    figure : str
        Figure as a data URI.
    maps : list[tuple[str, list[Map]]]
        Convergence maps by method; none if they would repeat its success rate.
    worst : list[tuple[str, list[Bad]]]
        Worst runs by method.
    """

    name: str
    summaries: list[Summary]
    comparisons: list[PairedComparison]
    figure: str
    maps: list[tuple[str, list[ConvergenceMap]]]
    worst: list[tuple[str, list[WorstRun]]]


@dataclass(frozen=True)
class StudyNumbers:
    """Numbers of a study, for the terminal.

    Parameters
    ----------
    summaries : list[Summary]
        Numbers of every method under every condition.
    comparisons : list[PairedComparison]
        Comparisons of every method with the first one.
    """

    summaries: list[Summary]
    comparisons: list[PairedComparison]


def write_report(
    folder: Path, plan: StudyPlan, table: Any, about: Mapping[str, Any], page: bool
) -> StudyNumbers:
    """Write summary.json and, if `page` is set, the HTML page.

    Parameters
    ----------
    folder : Path
        Folder of the study.
    plan : StudyPlan
        Methods, scenes and conditions.
    table : Any
        Rows of all runs.
    about : Mapping[str, Any]
        Description of how the study was made: command, package, date.
    page : bool
        Write the page in addition to the numbers.
    """
    groups = group_runs(plan, table)
    summaries, compared = [summarise(group) for group in groups], list(compare_with_first(groups))
    numbers = {
        **about,
        "methods": [asdict(one) for one in summaries],
        "comparisons": [asdict(one) for one in compared],
    }
    write_atomically(
        folder / SUMMARY_FILE, json.dumps(_to_json(numbers), indent=1, ensure_ascii=False) + "\n"
    )
    if page:
        names = list(dict.fromkeys(group.condition for group in groups))
        conditions = [_report_condition(name, groups, summaries, compared, plan) for name in names]
        write_atomically(folder / REPORT_FILE, _render_page(plan, table, about, conditions))
    return StudyNumbers(summaries, compared)


def _to_json(value: Any) -> Any:
    """Return a value for JSON: intervals as tables, numbers that are not finite as None."""
    if isinstance(value, Interval):
        return _to_json(value._asdict())
    if is_table(value):
        return {key: _to_json(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_to_json(one) for one in cast(list[Any], value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _report_condition(
    name: str,
    groups: list[Group],
    summaries: list[Summary],
    compared: list[PairedComparison],
    plan: StudyPlan,
) -> ConditionReport:
    here = [group for group in groups if group.condition == name]
    drawing = charts.render_svg(_make_figure(here, plan.duration)).encode()
    return ConditionReport(
        name=name,
        summaries=[one for one in summaries if one.condition == name],
        comparisons=[one for one in compared if one.condition == name],
        figure=make_data_uri("image/svg+xml", drawing),
        maps=[(group.method, maps) for group in here if (maps := _make_maps(group))],
        worst=[(group.method, _find_worst_runs(group)) for group in here],
    )


def _make_maps(group: Group) -> list[ConvergenceMap]:
    """Return the convergence maps of a group that have more than one cell."""
    maps = [make_map(group, *axes) for axes in MAP_AXES]
    return [found for found in maps if found.has_several_cells]


def _make_figure(here: list[Group], duration: float) -> Figure:
    """Draw the cumulative distributions of time to 1 mm and of pose error, by method."""
    ends = 0.0, duration
    times = [_make_cdf(g.method, g.first_within, i, ends) for i, g in enumerate(here)]
    poses = [_make_cdf(g.method, g.column("pose_error_mm"), i, ()) for i, g in enumerate(here)]
    panels = [
        Panel("time to 1 mm, s", "fraction of the runs", times, y_limits=(-0.02, 1.02)),
        Panel("pose error, mm", "fraction of the runs", poses, log_x=True, y_limits=(-0.02, 1.02)),
    ]
    return Figure("", panels, columns=2)


def _make_cdf(label: str, values: Floats, style: int, ends: tuple[float, ...]) -> Curve:
    """Return the cumulative distribution of values (n,) as a step curve.

    It extends from the first to the last of the `ends`, if given, and stays below 1 if some values
    are infinite.
    """
    known = np.sort(values[np.isfinite(values)])
    count = min(len(known), MAX_CURVE_STEPS)
    indices = np.unique(np.linspace(0, len(known) - 1, count).round().astype(int))
    fractions = np.concatenate([[0.0], (indices + 1) / len(values)])
    x = np.concatenate([ends[:1], np.repeat(known[indices], 2), ends[1:]])
    y = np.repeat(fractions, 2)
    return make_curve(label, x, y if ends else y[1:-1], style)


def _find_worst_runs(group: Group) -> list[WorstRun]:
    """Return the runs of a group with the largest pose errors."""
    pose = group.column("pose_error_mm")
    order = np.argsort(-np.nan_to_num(pose, nan=np.inf), kind="stable")[:WORST_RUN_COUNT]
    rows = group.rows.take(order.tolist()).to_pylist()
    return [
        WorstRun(
            group.row_index(int(i)),
            row["seed"],
            row["repetition"],
            row["pose_error_mm"],
            row["unnoticed_mm"],
            row["stop"],
        )
        for i, row in zip(order, rows, strict=True)
    ]


def _render_page(
    plan: StudyPlan, table: Any, about: Mapping[str, Any], conditions: list[ConditionReport]
) -> str:
    return render_template(
        "rcmservo.study.report",
        about=about,
        plan=plan,
        conditions=conditions,
        meanings=COLUMN_MEANINGS,
        cpus=table["cpu"].unique().to_pylist(),
        versions=table["versions"].unique().to_pylist(),
        colour=_choose_colour,
    )


def _choose_colour(fraction: float) -> str:
    """Return the background of a success rate: orange for 0, white for 0.5, green for 1."""
    ends = (230, 159, 0) if fraction < 0.5 else (0, 158, 115)
    strength = 0.75 * abs(2.0 * fraction - 1.0)
    return "rgb({})".format(", ".join(f"{255 - strength * (255 - c):.0f}" for c in ends))
