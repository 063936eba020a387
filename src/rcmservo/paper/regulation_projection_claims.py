"""Check of IV-B: regulation with the projection-based estimator, Fig. 7, 9 and 11.

Experiment `regulation-projection`. The printed Γ gets 10⁴ s of estimator time for each fit, because
its slowest modes take hours in real time (pitfall T6); some runs show this. The observations are
random, as in the paper, or selected by leverage, as in the built-in estimators. For comparison,
other runs use the default estimator (fit of the whole projection) and gain k = 8 of rcmservo.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.figures import plots
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.paper.lab import regulation
from rcmservo.paper.lab.closed_loop import closed_loop, read_task_record
from rcmservo.paper.lab.paper_settings import PROJECTION_EXPLORATION, SLOW_ESTIMATOR
from rcmservo.paper.lab.random_observations import RandomObservations
from rcmservo.paper.lab.regulation import MAX_FAITHFUL_ERROR, Regulation, started_runs
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, finite, format_range, fraction, median

SOON_S = 10.0
"""Time (s) within which the defaults must bring the errors below 2 %."""
CHOSEN = "projection-based, 10⁴ s per fit, chosen observations"
RANDOM = "projection-based, 10⁴ s per fit, random observations"
RANDOM_ESTIMATOR = RandomObservations()


def make_default_plan(settings: Settings) -> Regulation:
    """Return a regulation with the defaults of rcmservo."""
    estimator, exploration, controller = DltEstimator(), Exploration(), SaturatedController()
    duration = settings.default_duration
    return Regulation(estimator, exploration, True, duration, controller=controller)


def tasks(settings: Settings) -> list[Task]:
    seeds, duration, exploration = range(settings.seeds), settings.duration, PROJECTION_EXPLORATION
    chosen = Regulation(SLOW_ESTIMATOR, exploration, settings.pictures, duration)
    random = Regulation(RANDOM_ESTIMATOR, exploration, False, duration)
    real_time = partial(explore_in_real_time, settings=settings)
    return [
        *chosen.tasks("seed", seeds),
        *random.tasks("random", seeds),
        *make_default_plan(settings).tasks("default", range(settings.defaults)),
        *Task.per_seed("real-time", real_time, range(settings.real_time), 25.0, in_folder=True),
    ]


def explore_in_real_time(folder: Path, seed: int, settings: Settings) -> TaskResult:
    """Explore with the printed Γ in real time, up to the time limit of the exploration.

    Returns whether the exploration succeeded, and the scaled error of the last Ĵ before the servo
    reset the estimate.
    """
    estimator = RandomObservations(estimator_time=0.0)
    servo = Regulation(estimator, PROJECTION_EXPLORATION, False, settings.duration).servo
    with closed_loop(folder, seed, regulation.REGULATION_LABORATORY, False, servo) as loop:
        target, _ = loop.teach(loop.rig.scene.target)
        loop.rig.go_home()
        tick = loop.explore(target)
    errors = read_task_record(folder).truth["jacobian_error"][:, 0]
    return {"explored": tick.state.explored, "error": finite(errors)[-1]}


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds, slow_seeds, default_seeds = (
        range(count) for count in (settings.seeds, settings.real_time, settings.defaults)
    )
    cases = {RANDOM: results.per_seed("random", seeds), CHOSEN: results.per_seed("seed", seeds)}
    for case, runs in cases.items():
        yield regulation.measure_success(runs, seeds, case)
    slow = results.per_seed("real-time", slow_seeds)
    error, unexplored = median(column(slow, "error")), sum(not run["explored"] for run in slow)
    is_too_slow, seconds = error > MAX_FAITHFUL_ERROR, PROJECTION_EXPLORATION.max_time
    texts = Texts(seconds=seconds, unexplored=unexplored, explorations=len(slow))
    yield Measurement("real-time", error, slow_seeds, confirmed=is_too_slow, **texts)
    for measure_case in (regulation.measure_approximation, regulation.measure_fall, measure_model):
        for case, runs in cases.items():
            if started_runs(runs):
                yield measure_case(runs, seeds, case)
    runs = started_runs(results.per_seed("default", default_seeds))
    times = column(runs, "time_to_small")
    soon, listed = 100.0 * fraction(times <= SOON_S), [f"{time:.1f}" for time in finite(times)]
    texts = Texts(soon=SOON_S, times=", ".join(listed), pose=median(column(runs, "pose")))
    yield Measurement("defaults-are-soon", soon, default_seeds, **texts)


def measure_model(runs: list[TaskResult], seeds: range, case: str) -> Measurement:
    """Return the measurement that π of (34) follows m₁."""
    known, errors, missing = regulation.select_measured(runs, seeds, "π", "model")
    texts = Texts(ends=format_range(errors), missing=missing)
    return Measurement("model-follows", median(errors), known, case=(case,), **texts)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    yield from regulation.draw_regulation(settings, results, CHOSEN)
    record = read_task_record(results.folders["seed-0"])
    began = regulation.start_time(results["seed-0"])
    yield PaperFigure("estimate", [0], plots.plot_projection(record, began))
    labels = {"random-0": "10⁴ s of estimator time per fit", "real-time-0": "real time"}
    curves = list[Curve]()
    for style, (task, label) in enumerate(labels.items()):
        record = read_task_record(results.folders[task])
        new = record.new_frames()
        new = new[record.time[new] <= PROJECTION_EXPLORATION.max_time]
        errors = record.truth["jacobian_error"][new, 0]
        curves.append(make_curve(label, record.time[new], errors, style))
    scaled, levels = "scaled $\\|\\hat J - J\\| / \\|J\\|$", [("30 %", MAX_FAITHFUL_ERROR)]
    panel = Panel("time [s]", scaled, curves, levels=levels, log_y=True)
    yield PaperFigure("real-time", [0], Figure("The printed Γ in real time", [panel]))
    record, run = read_task_record(results.folders["default-0"]), results["default-0"]
    yield PaperFigure("default", [0], regulation.draw_errors(record, run, SOON_S))
