"""Experiment `regulation-projection`: the projection-based estimator, Fig. 7, 9 and 11.

The printed Γ gets 10⁴ s of estimator time for each fit, because its slowest modes take hours in
real time (T6); some runs show this. The observations are random, as in the paper, or selected by
leverage, as in the built-in estimators. For comparison, other runs use the default estimator (fit
of the whole projection) and gain k = 8 of rcmservo.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.figures import plots
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.paper.lab.closed_loop import (
    PAPER_PROJECTION_ESTIMATOR,
    PROJECTION_EXPLORATION,
    closed_loop,
    read_task_record,
)
from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.lab.regulation import (
    MAX_FAITHFUL_ERROR,
    REGULATION_LABORATORY,
    Regulation,
    approximates,
    errors_figure,
    falls_by_k_b,
    figures,
    measured_runs,
    start_time,
    started_runs,
    succeeds,
)
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, ends_of, finite, fraction, median

SOON_S = 10.0
"""Time (s) within which the defaults must bring the errors below 2 %."""
CHOSEN = "projection-based, 10⁴ s per fit, chosen observations"
RANDOM = "projection-based, 10⁴ s per fit, random observations"
RANDOM_ESTIMATOR = RandomObservations()


def default_plan(settings: Settings) -> Regulation:
    """Return a regulation with the defaults of rcmservo."""
    duration = settings.default_duration
    return Regulation(
        DltEstimator(), Exploration(), True, duration, controller=SaturatedController()
    )


def fixed_settings() -> dict[str, object]:
    return {
        "estimators": (PAPER_PROJECTION_ESTIMATOR, RANDOM_ESTIMATOR),
        "exploration": PROJECTION_EXPLORATION,
        "laboratory": REGULATION_LABORATORY,
    }


def tasks(settings: Settings) -> list[Task]:
    seeds, duration = range(settings.seeds), settings.duration
    slow = partial(in_real_time, settings=settings)
    return [
        *Regulation(
            PAPER_PROJECTION_ESTIMATOR, PROJECTION_EXPLORATION, settings.pictures, duration
        ).tasks("seed", seeds),
        *Regulation(RANDOM_ESTIMATOR, PROJECTION_EXPLORATION, False, duration).tasks(
            "random", seeds
        ),
        *default_plan(settings).tasks("default", range(settings.defaults)),
        *Task.per_seed("real-time", slow, range(settings.real_time), 25.0, in_folder=True),
    ]


def in_real_time(folder: Path, seed: int, settings: Settings) -> TaskResult:
    """Explore with the printed Γ in real time, up to the time limit of the exploration.

    Returns whether the exploration succeeded, and the scaled error of the last Ĵ before the servo
    reset the estimate.
    """
    now = Regulation(
        RandomObservations(estimator_time=0.0), PROJECTION_EXPLORATION, False, settings.duration
    )
    with closed_loop(folder, seed, REGULATION_LABORATORY, now.pictures, now.servo) as loop:
        target, _ = loop.teach(loop.rig.scene.target)
        loop.rig.move_to_start()
        tick = loop.explore(target)
    errors = read_task_record(folder).truth["jacobian_error"][:, 0]
    return {"explored": tick.state.explored, "error": finite(errors)[-1]}


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    cases = {RANDOM: results.per_seed("random", seeds), CHOSEN: results.per_seed("seed", seeds)}
    for case, runs in cases.items():
        yield succeeds(runs, seeds, case)
    slow = results.per_seed("real-time", range(settings.real_time))
    error = median(column(slow, "error"))
    yield Measurement(
        "real-time",
        error,
        range(settings.real_time),
        confirmed=error > MAX_FAITHFUL_ERROR,
        seconds=PROJECTION_EXPLORATION.max_time,
        unexplored=sum(not one["explored"] for one in slow),
        explorations=len(slow),
    )
    for measurement in (approximates, falls_by_k_b, _model_follows):
        for case, runs in cases.items():
            if started_runs(runs):
                yield measurement(runs, seeds, case)
    runs = started_runs(results.per_seed("default", range(settings.defaults)))
    times = column(runs, "time_to_small")
    yield Measurement(
        "defaults-are-soon",
        100.0 * fraction(times <= SOON_S),
        range(settings.defaults),
        soon=SOON_S,
        times=", ".join(f"{time:.1f}" for time in finite(times)),
        pose=median(column(runs, "pose")),
    )


def _model_follows(runs: list[TaskResult], seeds: range, case: str) -> Measurement:
    known, errors, missing = measured_runs(runs, seeds, "π", "model")
    value, ends = median(errors), ends_of(errors)
    return Measurement("model-follows", value, known, case=(case,), ends=ends, missing=missing)


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    yield from figures(settings, results, CHOSEN)
    chart = plots.plot_projection(
        read_task_record(results.folders["seed-0"]), start_time(results["seed-0"])
    )
    yield ReportFigure("estimate", [0], chart)
    names = {"random-0": "10⁴ s of estimator time per fit", "real-time-0": "real time"}
    curves = list[Curve]()
    for style, (task, label) in enumerate(names.items()):
        rows = read_task_record(results.folders[task])
        new = rows.new_frames()
        new = new[rows.time[new] <= PROJECTION_EXPLORATION.max_time]
        errors = rows.truth["jacobian_error"][new, 0]
        curves.append(make_curve(label, rows.time[new], errors, style))
    scaled, levels = "scaled $\\|\\hat J - J\\| / \\|J\\|$", [("30 %", MAX_FAITHFUL_ERROR)]
    panel = Panel("time [s]", scaled, curves, levels=levels, log_y=True)
    yield ReportFigure("real-time", [0], Figure("The printed Γ in real time", [panel]))
    rows, run = read_task_record(results.folders["default-0"]), results["default-0"]
    yield ReportFigure("default", [0], errors_figure(rows, run, SOON_S))
