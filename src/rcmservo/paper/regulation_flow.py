"""Experiment `regulation-flow`: regulation with the flow-based estimator, Fig. 8, 10 and 12.

On the path the imaged tool rotates by 40°, and J changes by most of its size. At 1 mm/s the flow
rule does not follow this change (T7), so the Ĵ of the exploration must suffice for the whole path.
The tool therefore explores half-way, where Ĵ is within 20° of both ends. The same scenes also run
with the exploration at the start.
"""

from collections.abc import Iterator

from rcmservo.figures import plots
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.closed_loop import FLOW_ESTIMATOR, FLOW_EXPLORATION, read_task_record
from rcmservo.paper.lab.regulation import (
    MAX_FAITHFUL_ERROR,
    NOTICED_S,
    REGULATION_LABORATORY,
    Regulation,
    approximates,
    falls_by_k_b,
    figures,
    is_small,
    moving_means,
    start_time,
    started_runs,
    succeeds,
)
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task
from rcmservo.paper.statistics import column, ends_of, median

FLOWS = (
    "$\\dot s, \\omega_1$ [deg/s]",
    "$\\dot r, \\omega_2$ [px/s]",
    "$\\dot d, \\omega_3$ [px/s]",
)
HALF_WAY = "flow-based, explored half-way"
FROM_START = "flow-based, explored at the start"


def fixed_settings() -> dict[str, object]:
    return {
        "estimator": FLOW_ESTIMATOR,
        "exploration": FLOW_EXPLORATION,
        "laboratory": REGULATION_LABORATORY,
    }


def tasks(settings: Settings) -> list[Task]:
    seeds, duration = range(settings.seeds), settings.duration
    half_way = Regulation(
        FLOW_ESTIMATOR, FLOW_EXPLORATION, settings.pictures, duration, half_way=True
    )
    from_start = Regulation(FLOW_ESTIMATOR, FLOW_EXPLORATION, False, duration)
    return [*half_way.tasks("seed", seeds), *from_start.tasks("from-start", seeds)]


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    runs, other = (results.per_seed(prefix, seeds) for prefix in ("seed", "from-start"))
    yield succeeds(runs, seeds, HALF_WAY)
    yield succeeds(other, seeds, FROM_START)
    yield approximates(runs, seeds, HALF_WAY)
    yield falls_by_k_b(runs, seeds, HALF_WAY)
    at_end = median(column(started_runs(runs), "at_end"))
    yield Measurement("every-instant", at_end, seeds, confirmed=at_end > MAX_FAITHFUL_ERROR)
    errors, noise = (column(started_runs(runs), key) for key in ("flow_error", "flow_noise"))
    value, words = median(errors), ends_of(errors)
    yield Measurement(
        "omega-follows", value, seeds, remarked=value > MAX_FAITHFUL_ERROR, ends=words
    )
    value, words = median(noise), ends_of(noise)
    yield Measurement("less-noise", value, seeds, confirmed=value < 1.0, ends=words)
    reached = [run for run in other if is_small(run)]
    error = median(column(reached or started_runs(other), "at_end"))
    yield Measurement(
        "success-shows",
        error,
        seeds,
        trials=len(reached),
        confirmed=error > MAX_FAITHFUL_ERROR,
        reached=len(reached),
        runs=len(other),
    )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    yield from figures(settings, results, HALF_WAY)
    rows, began = (
        read_task_record(results.folders["seed-0"]),
        start_time(results["seed-0"]) + NOTICED_S,
    )
    new = rows.new_frames(began)
    y_dot, omega = (flow * plots.DISPLAY_UNITS for flow in plots.compute_flows(rows, new))
    time = rows.time[new][1:] - began
    mean_time = moving_means(time[:, None])[:, 0]
    panels = list[Panel]()
    for i in range(3):
        panels.append(_panel(i, "time [s]", time, y_dot, omega))
        label = "time [s], means over 1 s"
        panels.append(_panel(i, label, mean_time, moving_means(y_dot), moving_means(omega)))
    yield ReportFigure("estimate", [0], Figure("Output flow", panels, columns=2))


def _panel(i: int, label: str, time: Floats, y_dot: Floats, omega: Floats) -> Panel:
    names = ("measured $\\dot{\\mathbf{y}}$", "estimate $\\mathbf{\\omega}$ (35)")
    first, second = names if i == 0 else ("", "")
    curves = [make_curve(first, time, y_dot[:, i], -1), make_curve(second, time, omega[:, i], 1)]
    return Panel(label, FLOWS[i], curves)
