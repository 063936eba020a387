"""Check of IV-B: regulation with the flow-based estimator, Fig. 8, 10 and 12.

Experiment `regulation-flow`. On the path the imaged tool rotates by 40°, and J changes by most of
its size. At 1 mm/s the flow rule does not follow this change (pitfall T7), so the Ĵ of the
exploration must suffice for the whole path. The tool therefore explores half-way, where Ĵ is within
20° of both ends. The same scenes also run with the exploration at the start.
"""

from collections.abc import Iterator

from rcmservo.figures import plots
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.paper.lab import regulation
from rcmservo.paper.lab.closed_loop import read_task_record
from rcmservo.paper.lab.paper_settings import FLOW_ESTIMATOR, FLOW_EXPLORATION
from rcmservo.paper.lab.regulation import MAX_FAITHFUL_ERROR, Regulation, moving_means, started_runs
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, Texts
from rcmservo.paper.statistics import column, format_range, median

FLOW_LABELS = (
    "$\\dot s, \\omega_1$ [deg/s]",
    "$\\dot r, \\omega_2$ [px/s]",
    "$\\dot d, \\omega_3$ [px/s]",
)
HALF_WAY = "flow-based, explored half-way"
FROM_START = "flow-based, explored at the start"


def tasks(settings: Settings) -> list[Task]:
    seeds = range(settings.seeds)
    duration = settings.duration
    method = (FLOW_ESTIMATOR, FLOW_EXPLORATION)
    half_way = Regulation(*method, settings.pictures, duration, half_way=True)
    from_start = Regulation(*method, False, duration)
    return [*half_way.tasks("seed", seeds), *from_start.tasks("from-start", seeds)]


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    runs, from_start = (results.per_seed(prefix, seeds) for prefix in ("seed", "from-start"))
    yield regulation.measure_success(runs, seeds, HALF_WAY)
    yield regulation.measure_success(from_start, seeds, FROM_START)
    yield regulation.measure_approximation(runs, seeds, HALF_WAY)
    yield regulation.measure_fall(runs, seeds, HALF_WAY)
    at_end, flow_errors, flow_noise = (
        column(started_runs(runs), key) for key in ("at_end", "flow_error", "flow_noise")
    )
    is_inaccurate = median(at_end) > MAX_FAITHFUL_ERROR
    yield Measurement("every-instant", median(at_end), seeds, confirmed=is_inaccurate)
    error, ends = median(flow_errors), format_range(flow_errors)
    yield Measurement("omega-follows", error, seeds, remarked=error > MAX_FAITHFUL_ERROR, ends=ends)
    noise, ends = median(flow_noise), format_range(flow_noise)
    yield Measurement("less-noise", noise, seeds, confirmed=noise < 1.0, ends=ends)
    reached = [run for run in from_start if regulation.is_small(run)]
    error, count = median(column(reached or started_runs(from_start), "at_end")), len(reached)
    texts, is_inaccurate = Texts(reached=count, runs=len(from_start)), error > MAX_FAITHFUL_ERROR
    yield Measurement("success-shows", error, seeds, trials=count, confirmed=is_inaccurate, **texts)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    yield from regulation.draw_regulation(settings, results, HALF_WAY)
    record = read_task_record(results.folders["seed-0"])
    began = regulation.start_time(results["seed-0"]) + regulation.NOTICED_S
    new = record.new_frames(began)
    y_dot, omega = (flow * plots.DISPLAY_UNITS for flow in plots.compute_flows(record, new))
    time = record.time[new][1:] - began
    unfiltered = ("time [s]", time, y_dot, omega)
    means = (moving_means(time[:, None])[:, 0], moving_means(y_dot), moving_means(omega))
    panels = list[Panel]()
    for i, y_label in enumerate(FLOW_LABELS):
        for x_label, x, measured, estimated in (unfiltered, ("time [s], means over 1 s", *means)):
            names = "measured $\\dot{\\mathbf{y}}$", "estimate $\\mathbf{\\omega}$ (35)"
            names = names if i == 0 else ("", "")
            measured_curve = make_curve(names[0], x, measured[:, i], -1)
            curves = [measured_curve, make_curve(names[1], x, estimated[:, i], 1)]
            panels.append(Panel(x_label, y_label, curves))
    yield PaperFigure("estimate", [0], Figure("Output flow", panels, columns=2))
