"""Report of a study: an HTML page that opens without a network, and its numbers in summary.json."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

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
    numbers = StudyNumbers(list(map(summarise, groups)), list(compare_with_first(groups)))
    methods, comparisons = map(asdict, numbers.summaries), map(asdict, numbers.comparisons)
    content = {**about, "methods": list(methods), "comparisons": list(comparisons)}
    text = json.dumps(_to_json(content), indent=1, ensure_ascii=False)
    write_atomically(folder / SUMMARY_FILE, text + "\n")
    if page:
        names = dict.fromkeys(group.condition for group in groups)
        sections = [_make_section(name, groups, numbers, plan.duration) for name in names]
        write_atomically(folder / REPORT_FILE, _render_page(plan, table, about, sections))
    return numbers


def _to_json(value: Any) -> Any:
    """Return a value for JSON: intervals as tables, numbers that are not finite as None."""
    if isinstance(value, Interval):
        return _to_json(value._asdict())
    if is_table(value):
        return {key: _to_json(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_to_json(entry) for entry in cast(list[Any], value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _make_section(
    condition: str, groups: list[Group], numbers: StudyNumbers, duration: float
) -> dict[str, Any]:
    """Return the section of the page about one condition, as the template reads it.

    Parameters
    ----------
    condition : str
        Label of the condition.
    groups : list[Group]
        Runs of all methods under all conditions.
    numbers : StudyNumbers
        Numbers of all groups.
    duration : float
        Length of each run, s.
    """
    members = [group for group in groups if group.condition == condition]
    drawing = charts.render_svg(make_figure(members, duration)).encode()
    return {
        "name": condition,
        "summaries": [row for row in numbers.summaries if row.condition == condition],
        "comparisons": [row for row in numbers.comparisons if row.condition == condition],
        "figure": make_data_uri("image/svg+xml", drawing),
        "maps": [(group.method, maps) for group in members if (maps := _make_maps(group))],
        "worst": [(group.method, _find_worst_runs(group)) for group in members],
    }


def _make_maps(group: Group) -> list[ConvergenceMap]:
    """Return the convergence maps of a group that have more than one cell."""
    maps = [make_map(group, *axes) for axes in MAP_AXES]
    return [convergence for convergence in maps if convergence.has_several_cells]


def make_figure(groups: list[Group], duration: float) -> Figure:
    """Draw the cumulative distributions of time to 1 mm and of pose error, by method."""
    ends, y_label, y_limits = (0.0, duration), "fraction of the runs", (-0.02, 1.02)
    times = [_make_cdf(g.method, g.first_within, i, ends) for i, g in enumerate(groups)]
    poses = [_make_cdf(g.method, g.column("pose_error_mm"), i, ()) for i, g in enumerate(groups)]
    panels = [
        Panel("time to 1 mm, s", y_label, times, y_limits=y_limits),
        Panel("pose error, mm", y_label, poses, log_x=True, y_limits=y_limits),
    ]
    return Figure("", panels, columns=2)


def _make_cdf(label: str, values: Floats, style: int, ends: tuple[float, ...]) -> Curve:
    """Return the cumulative distribution of values (n,) as a step curve.

    It extends from the first to the last of the `ends`, if given, and stays below 1 if some values
    are infinite.
    """
    ordered = np.sort(values[np.isfinite(values)])
    step_count = min(len(ordered), MAX_CURVE_STEPS)
    indices = np.unique(np.linspace(0, len(ordered) - 1, step_count).round().astype(int))
    fractions = np.concatenate([[0.0], (indices + 1) / len(values)])
    x = np.concatenate([ends[:1], np.repeat(ordered[indices], 2), ends[1:]])
    y = np.repeat(fractions, 2)
    return make_curve(label, x, y if ends else y[1:-1], style)


def _find_worst_runs(group: Group) -> list[dict[str, Any]]:
    """Return the rows with the largest pose errors; `index` is that in the table of all runs."""
    pose_mm = group.column("pose_error_mm")
    order = np.argsort(-np.nan_to_num(pose_mm, nan=np.inf), kind="stable")[:WORST_RUN_COUNT]
    rows = group.rows.take(order.tolist()).to_pylist()
    return [{**row, "index": group.row_index(int(i))} for i, row in zip(order, rows, strict=True)]


def _render_page(
    plan: StudyPlan, table: Any, about: Mapping[str, Any], sections: list[dict[str, Any]]
) -> str:
    return render_template(
        "rcmservo.study.report",
        about=about,
        plan=plan,
        conditions=sections,
        meanings=COLUMN_MEANINGS,
        cpus=table["cpu"].unique().to_pylist(),
        versions=table["versions"].unique().to_pylist(),
        colour=_choose_colour,
    )


def _choose_colour(fraction: float) -> str:
    """Return the background of a success rate: orange for 0, white for 0.5, green for 1."""
    strongest = (230, 159, 0) if fraction < 0.5 else (0, 158, 115)
    strength = 0.75 * abs(2.0 * fraction - 1.0)
    channels = (f"{255 - strength * (255 - channel):.0f}" for channel in strongest)
    return f"rgb({', '.join(channels)})"
