"""The report of a study: one HTML file that opens offline, and summary.json with its numbers."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from rcmservo.config.atomic_files import write_whole
from rcmservo.config.texts import is_table
from rcmservo.figures import charts
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.study.execution.store import REPORT, SUMMARY
from rcmservo.study.plan.plan import StudyPlan
from rcmservo.study.report.html import embedded, rendered
from rcmservo.study.report.maps import AXES, Map, map_of
from rcmservo.study.report.statistics import Interval
from rcmservo.study.report.summary import (
    Group,
    PairedComparison,
    Summary,
    comparisons,
    groups,
    summary_of,
)
from rcmservo.study.row import MEANINGS

WORST = 5
"""Runs of each method that are told apart."""
STEPS = 200
"""Of a curve at most: more cannot be seen."""


class Bad(NamedTuple):
    """A run that went badly.

    Parameters
    ----------
    case : int
        Its row in runs.parquet, from 0.
    seed : int
        Of its scene.
    repetition : int
        Which noise.
    pose_mm : float
        Off at the end.
    unnoticed_mm : float
        By which the error grew without a word.
    stop : str
        Cause of its first stop; empty if none.
    """

    case: int
    seed: int
    repetition: int
    pose_mm: float
    unnoticed_mm: float
    stop: str


@dataclass(frozen=True)
class Condition:
    """All that is told of one condition.

    Parameters
    ----------
    name : str
        In words.
    summaries : list[Summary]
        Of every method.
    comparisons : list[PairedComparison]
        Of all methods but the first with that.
    figure : str
        As data that the page embeds.
    maps : list[tuple[str, list[Map]]]
        By method; none where they would repeat its success rate.
    worst : list[tuple[str, list[Bad]]]
        By method.
    """

    name: str
    summaries: list[Summary]
    comparisons: list[PairedComparison]
    figure: str
    maps: list[tuple[str, list[Map]]]
    worst: list[tuple[str, list[Bad]]]


@dataclass(frozen=True)
class ReportTold:
    """What the terminal tells of a study.

    Parameters
    ----------
    summaries : list[Summary]
        Of every method under every condition.
    comparisons : list[PairedComparison]
        Of every method with the first one.
    """

    summaries: list[Summary]
    comparisons: list[PairedComparison]


def write(
    folder: Path, plan: StudyPlan, table: Any, about: Mapping[str, Any], page: bool
) -> ReportTold:
    """Write summary.json and, if it is wanted, the page. `about` says how the study was made."""
    found = groups(plan, table)
    summaries, beside = [summary_of(group) for group in found], list(comparisons(found))
    numbers = {
        **about,
        "methods": [asdict(one) for one in summaries],
        "comparisons": [asdict(one) for one in beside],
    }
    write_whole(folder / SUMMARY, json.dumps(_plain(numbers), indent=1, ensure_ascii=False) + "\n")
    if page:
        names = list(dict.fromkeys(group.condition for group in found))
        conditions = [_condition(name, found, summaries, beside, plan) for name in names]
        write_whole(folder / REPORT, _page(plan, table, about, conditions))
    return ReportTold(summaries, beside)


def _plain(value: Any) -> Any:
    """The same for JSON: intervals as tables, and null for what is not finite."""
    if isinstance(value, Interval):
        return _plain(value._asdict())
    if is_table(value):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in cast(list[Any], value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _condition(
    name: str,
    found: list[Group],
    summaries: list[Summary],
    beside: list[PairedComparison],
    plan: StudyPlan,
) -> Condition:
    here = [group for group in found if group.condition == name]
    drawing = charts.render_svg(_figure(here, plan.duration)).encode()
    return Condition(
        name=name,
        summaries=[one for one in summaries if one.condition == name],
        comparisons=[one for one in beside if one.condition == name],
        figure=embedded("image/svg+xml", drawing),
        maps=[(group.method, maps) for group in here if (maps := _maps(group))],
        worst=[(group.method, _worst(group, plan)) for group in here],
    )


def _maps(group: Group) -> list[Map]:
    """Where it converges."""
    return [one for axes in AXES if (one := map_of(group, *axes)).divides]


def _figure(here: list[Group], duration: float) -> Figure:
    """Which share of the runs was there after so many s, and ended so near."""
    times = [_shares(g.method, g.first_within, i, (0.0, duration)) for i, g in enumerate(here)]
    poses = [_shares(g.method, g.column("pose_error_mm"), i, ()) for i, g in enumerate(here)]
    panels = [
        Panel("s until first within 1 mm", "share of the runs", times, y_limits=(-0.02, 1.02)),
        Panel("mm off at the end", "share of the runs", poses, log_x=True, y_limits=(-0.02, 1.02)),
    ]
    return Figure("", panels, columns=2)


def _shares(label: str, values: Floats, style: int, ends: tuple[float, ...]) -> Curve:
    """The share of all runs with at most this value, as steps, from the first to the last of the
    `ends` where there are any; it ends below 1 where some never came.
    """
    known = np.sort(values[np.isfinite(values)])
    places = np.unique(np.linspace(0, len(known) - 1, min(len(known), STEPS)).round().astype(int))
    shares = np.concatenate([[0.0], (places + 1) / len(values)])
    x = np.concatenate([ends[:1], np.repeat(known[places], 2), ends[1:]])
    y = np.repeat(shares, 2)
    return make_curve(label, x, y if ends else y[1:-1], style)


def _worst(group: Group, plan: StudyPlan) -> list[Bad]:
    """Its runs that went worst: those farthest from the target at the end."""
    pose = group.column("pose_error_mm")
    order = np.argsort(-np.nan_to_num(pose, nan=np.inf), kind="stable")[:WORST]
    rows = group.rows.take(order.tolist()).to_pylist()
    return [
        Bad(
            group.case(int(i)),
            row["seed"],
            row["repetition"],
            row["pose_error_mm"],
            row["unnoticed_mm"],
            row["stop"],
        )
        for i, row in zip(order, rows, strict=True)
    ]


def _page(
    plan: StudyPlan, table: Any, about: Mapping[str, Any], conditions: list[Condition]
) -> str:
    return rendered(
        "rcmservo.study.report",
        about=about,
        plan=plan,
        conditions=conditions,
        meanings=MEANINGS,
        cpus=table["cpu"].unique().to_pylist(),
        versions=table["versions"].unique().to_pylist(),
        tone=_tone,
    )


def _tone(share: float) -> str:
    """The colour behind a share, from orange over white to green; the number stands on it."""
    ends = (230, 159, 0) if share < 0.5 else (0, 158, 115)
    strength = 0.75 * abs(2.0 * share - 1.0)
    return "rgb({})".format(", ".join(f"{255 - strength * (255 - c):.0f}" for c in ends))
