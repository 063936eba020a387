"""Regulation of the paper, for either estimator, from errors of exactly [40°, 80 px, 60 px].

The tool explores from Ĵ = 0, returns to the start with the paper's gains, and moves to the taught
target. A run is faithful only if Ĵ is within 30 % of J after the exploration and the error of r
falls by k b = 1 px/s ± 30 % while saturated: a Ĵ that is too small multiplies k, so that a fast run
with it does not reproduce the paper.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress
from pathlib import Path

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.figures import plots
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.servo_loop import Tick
from rcmservo.paper.lab.closed_loop import (
    Arrived,
    ClosedLoop,
    closed_loop,
    make_servo,
    read_task_record,
)
from rcmservo.paper.lab.paper_settings import PAPER_CONTROLLER, PAPER_SCENES, POINT_NOISE_PX
from rcmservo.paper.plan import (
    Measurement,
    NotMeasured,
    PaperFigure,
    Results,
    Settings,
    Task,
    TaskResult,
    Texts,
)
from rcmservo.paper.statistics import column, format_range, fraction, median, rms
from rcmservo.recording.reader import Record
from rcmservo.safety.causes import Cause
from rcmservo.servo.servo import Servo
from rcmservo.sim import RigSettings
from rcmservo.study.report.statistics import format_finite

REGULATION_LABORATORY = RigSettings(scene=PAPER_SCENES, point_noise=POINT_NOISE_PX)
INITIAL_ERRORS = np.abs(np.array(PAPER_SCENES.errors, dtype=float))
"""Initial |Δy| (3,) in rad, px, px."""
SMALL_FRACTION = 0.02
"""Fraction of its initial value below which an error counts as regulated."""
MAX_FAITHFUL_ERROR = 0.3
"""Largest scaled ‖Ĵ − J‖/‖J‖ of a faithful run."""
SLOPE_TOLERANCE = 0.3
"""Largest difference (px/s) of the slope of r from 1 px/s in a faithful run."""
RETURN_TIMEOUT_S = 150.0
"""Time limit (s) of the return to the start."""
END_S = 2.0
"""Time (s) at the end over which the remaining error is averaged."""
NOTICED_S = 0.1
"""Time (s) after which Δy refers to the new target, while the tool has hardly moved."""
TICKS_PER_S = 100
"""Rate of the servo."""
INITIAL_FRAMES = 6
"""Frames over which the initial error is averaged."""
SATURATED_RATIO = 1.2
"""Ratio of an error to its bound b above which the controller surely saturates."""
MIN_SLOPE_FRAMES = 10
"""Smallest number of frames with saturation that give a slope."""
SMOOTH_FRAMES = 60
"""Frames, one second, over which a flow is averaged to separate signal from noise."""


@dataclass(frozen=True)
class Regulation:
    """Settings of a regulation.

    Parameters
    ----------
    estimator : Estimator
        Estimator of Ĵ.
    exploration : Exploration
        Exploration that the estimator requires.
    pictures : bool
        True for rendered frames; otherwise the camera delivers points.
    duration : float
        Duration (s) of the motion to the target.
    half_way : bool
        True to explore at the middle of the path instead of its start.
    controller : SaturatedController
        Controller of the return to the start and of the motion to the target.
    """

    estimator: Estimator
    exploration: Exploration
    pictures: bool
    duration: float
    half_way: bool = False
    controller: SaturatedController = PAPER_CONTROLLER

    @property
    def servo(self) -> Servo:
        """Servo of this regulation."""
        return make_servo(REGULATION_LABORATORY, self.estimator, self.exploration, self.controller)

    def tasks(self, prefix: str, seeds: Iterable[int]) -> list[Task]:
        """Return one task per seed."""
        cost = (0.35 if self.pictures else 0.03) * (self.duration + 80.0)
        return Task.per_seed(prefix, partial(regulate, plan=self), seeds, cost, in_folder=True)


def regulate(folder: Path, seed: int, plan: Regulation) -> TaskResult:
    """Explore, return to the start, regulate; return the cause at the end and `evaluate_record`."""
    with closed_loop(folder, seed, REGULATION_LABORATORY, plan.pictures, plan.servo) as loop:
        scene = loop.rig.scene
        home, _ = loop.teach(scene.start)
        target, p_d = loop.teach(scene.target)
        loop.rig.place(scene.midpoint if plan.half_way else scene.start)
        tick = loop.explore(home)
        if not tick.state.explored:
            cause = tick.state.cause.stop_sentence or Cause.NOT_EXPLORED.value
            return {"cause": cause, "began": None}
        tick = loop.finish_stage(home, RETURN_TIMEOUT_S, tick.state, done=Arrived())
        began = loop.elapsed()
        for count, newest in enumerate(loop.run_stage(target, plan.duration, tick.state)):
            tick = newest
            if count == round(TICKS_PER_S * NOTICED_S):
                _write_snapshot(loop, "initial", target, tick)
        _write_snapshot(loop, "final", target, tick)
    results = evaluate_record(read_task_record(folder), began, p_d, plan.controller)
    return {"cause": tick.state.cause.stop_sentence, **results}


def _write_snapshot(loop: ClosedLoop, moment: str, target: Target, tick: Tick) -> None:
    s, r, d = np.abs(tick.state.delta) * plots.DISPLAY_UNITS
    caption = f"{moment}: |ds| {s:.2f} deg  |dr| {r:.2f} px  |dd| {d:.2f} px"
    loop.write_snapshot(f"{moment}.png", target, tick.state, caption)


def evaluate_record(
    record: Record, began: float, p_d: Floats, controller: SaturatedController
) -> TaskResult:
    """Return the results of a run whose motion to the target started at the time `began` (s).

    ``explored``, ``at_start`` and ``at_end`` are scaled errors of Ĵ. ``initial`` is |Δy| (3,) and
    ``left`` the largest remaining fraction of it. ``slope`` is the rate (px/s) at which the error
    of r falls while saturated. ``pose`` is the rms of ‖p₂ − p_d‖ (mm) over the last second, and
    ``model`` the rms (px) of π (34) − m₁.
    """
    jacobian_error, recorded = record.truth["jacobian_error"][:, 0], record.time
    known = np.flatnonzero(np.isfinite(jacobian_error))
    explored = int(np.argmax([phase not in ("IDLE", "ACQUIRE") for phase in record.phase]))
    new = record.new_frames(began + NOTICED_S)
    errors, time = np.abs(record.ticks["delta"][new]), recorded[new] - began
    small = (errors < SMALL_FRACTION * INITIAL_ERRORS).all(axis=1)
    at_end = errors[time > time[-1] - END_S]
    pose_error = np.linalg.norm(record.truth["p2"] - p_d, axis=1)
    flow_error, flow_noise = _compare_flows(record, began + NOTICED_S)
    return {
        "began": began,
        "explored": jacobian_error[explored],
        "at_start": jacobian_error[known[recorded[known] >= began][0]],
        "at_end": jacobian_error[known[-1]],
        "initial": np.mean(errors[:INITIAL_FRAMES], axis=0),
        "slope": fit_slope(time, errors[:, 1], controller.bounds[1]),
        "left": np.max(np.sqrt(np.mean(at_end**2, axis=0)) / INITIAL_ERRORS),
        "time_to_small": time[np.argmax(small)] if small.any() else None,
        "pose": rms(pose_error[recorded > recorded[-1] - 1.0]),
        "model": _measure_model_error(record, began),
        "flow_error": flow_error,
        "flow_noise": flow_noise,
    }


def fit_slope(time: Floats, error: Floats, bound: float) -> float | None:
    """Return the rate (units/s) at which a saturated error falls; None if it never saturates."""
    saturated = error > SATURATED_RATIO * bound
    if saturated.sum() < MIN_SLOPE_FRAMES:
        return None
    return float(-np.polyfit(time[saturated], error[saturated], 1)[0])


def _measure_model_error(record: Record, began: float) -> float | None:
    """Return the rms distance (px) between π and m₁ from the start on; None without a model."""
    new, ticks = record.new_frames(began), record.ticks
    error = ticks["model"][new, :2] - (ticks["points"][new, :2] - ticks["o_c"][new])
    return rms(np.linalg.norm(error, axis=1)) if np.isfinite(error).all() else None


def _compare_flows(record: Record, since: float) -> tuple[float, float]:
    """Return the rms of ω (35) − ẏ, averaged over 1 s, and the noise of ω, relative to ẏ."""
    flows = plots.compute_flows(record, record.new_frames(since))
    y_dot, omega = (flow * plots.DISPLAY_UNITS for flow in flows)
    known = np.isfinite(y_dot).all(axis=1) & np.isfinite(omega).all(axis=1)
    y_dot, omega = y_dot[known], omega[known]  # a pause at the end invalidates the estimate
    mean = moving_means(y_dot)
    noise = rms(np.diff(omega, axis=0)) / rms(np.diff(y_dot, axis=0))
    return rms(moving_means(omega) - mean) / rms(mean), noise


def moving_means(flow: Floats) -> Floats:
    """Return moving averages over `SMOOTH_FRAMES` of a flow (n, 3)."""
    window = np.ones(SMOOTH_FRAMES) / SMOOTH_FRAMES
    return np.stack([np.convolve(column, window, mode="valid") for column in flow.T], axis=1)


def started_runs(runs: Iterable[TaskResult]) -> list[TaskResult]:
    """Return the runs that started their motion to the target."""
    return [run for run in runs if run["began"] is not None]


def is_small(run: TaskResult) -> bool:
    """Return True if all errors fell below 2 % and the servo did not stop."""
    return bool(started_runs([run])) and not run["cause"] and run["left"] < SMALL_FRACTION


def explain_failure(run: TaskResult) -> str:
    """Return why a run failed or is not faithful, as text; empty if it succeeded."""
    if run["began"] is None or run["cause"]:
        return run["cause"]
    if not run["explored"] <= MAX_FAITHFUL_ERROR:
        return f"error of Ĵ {run['explored']:.0%} after exploration"
    if run["slope"] is None or abs(run["slope"] - 1.0) > SLOPE_TOLERANCE:
        return f"r fell by {run['slope'] or np.nan:.2f} px/s"
    return "" if is_small(run) else f"{run['left']:.1%} of an error remains"


def measure_success(runs: Sequence[TaskResult], seeds: Sequence[int], case: str) -> Measurement:
    """Return the measurement that the errors fall as in the paper."""
    failures = [explain_failure(run) for run in runs]
    successful = [run for run, failure in zip(runs, failures, strict=True) if not failure]
    poses = column(successful, "pose")
    remaining = format_finite(max(100.0 * column(successful, "left"), default=np.nan), ".1f")
    middle, worst = format_finite(median(poses)), format_finite(max(poses, default=np.nan))
    initial = list[str]()
    if started_runs(runs):
        deviations = np.array([run["initial"] for run in started_runs(runs)]) - INITIAL_ERRORS
        s, r, d = np.max(np.abs(deviations), axis=0) * plots.DISPLAY_UNITS
        s_0, r_0, d_0 = INITIAL_ERRORS * plots.DISPLAY_UNITS
        initial = [
            f"initial errors [{s_0:.0f}°, {r_0:.0f} px, {d_0:.0f} px], which the servo measures "
            f"about its o_c to within {s:.2f}°, {r:.1f} px, {d:.1f} px"
        ]
    summary = [
        *initial,
        f"largest remaining error {remaining} %, pose error median {middle} mm, worst {worst} mm",
        *[f"seed {i}: {why}" for i, why in zip(seeds, failures, strict=True) if why],
    ]
    value = 100.0 * fraction(not failure for failure in failures)
    return Measurement("succeeds", value, seeds, case=(case,), summary="; ".join(summary))


def select_measured(
    runs: Sequence[TaskResult], seeds: Sequence[int], quantity: str, key: str
) -> tuple[list[int], Floats, str]:
    """Return seeds and values of the runs that have a result, and a remark on those without.

    Raises
    ------
    NotMeasured
        If no run has the result; `quantity` names it in the message.
    """
    values = column(runs, key)
    known = np.isfinite(values)
    if not known.any():
        raise NotMeasured(f"{quantity}, in any run", float("nan"))
    count = int((~known).sum())
    missing = f"; not measured in {count} of {len(runs)} runs" if count else ""
    return list(compress(seeds, known)), values[known], missing


def measure_approximation(
    runs: Sequence[TaskResult], seeds: Sequence[int], case: str
) -> Measurement:
    """Return the measurement that Ĵ approximates J after the exploration."""
    known, errors, missing = select_measured(runs, seeds, "the error of Ĵ", "explored")
    start, end = (median(column(started_runs(runs), key)) for key in ("at_start", "at_end"))
    texts = Texts(worst=errors.max(), start=start, end=end, missing=missing)
    return Measurement("approximates", median(errors), known, case=(case,), **texts)


def measure_fall(runs: Sequence[TaskResult], seeds: Sequence[int], case: str) -> Measurement:
    """Return the measurement that a saturated error falls by k b."""
    known, slopes, missing = select_measured(runs, seeds, "the slope of r", "slope")
    value, texts = median(np.abs(slopes - 1.0)), Texts(ends=format_range(slopes), missing=missing)
    return Measurement("falls-by-k-b", value, known, case=(case,), **texts)


def draw_regulation(settings: Settings, results: Results, case: str) -> Iterator[PaperFigure]:
    """Yield Fig. 7 or 8 (images) and 9 or 10 (errors) of seed 0, and a figure of all seeds."""
    seeds, folder = range(settings.seeds), results.folders["seed-0"]
    pictures = [folder / name for name in ("initial.png", "final.png")]
    if all(path.exists() for path in pictures):
        yield PaperFigure("pictures", [0], pictures=pictures)
    yield PaperFigure("errors", [0], draw_errors(read_task_record(folder), results["seed-0"]))
    chart = _draw_seeds(results.per_seed("seed", seeds))
    yield PaperFigure("seeds", seeds, chart, texts={"case": case})


def start_time(run: TaskResult) -> float:
    """Return the time (s) at which the motion to the target started; 0 if it did not."""
    return run["began"] or 0.0


def draw_errors(record: Record, run: TaskResult, until: float = float("inf")) -> Figure:
    """Return a figure of the error magnitudes over `until` s from the start: Fig. 9 and 10."""
    began = start_time(run)
    selected = (record.time >= began + NOTICED_S) & (record.time <= began + until)
    time, errors = record.time[selected] - began, np.abs(record.ticks["delta"][selected])
    errors, small = (x * plots.DISPLAY_UNITS for x in (errors, INITIAL_ERRORS * SMALL_FRACTION))
    panels = [
        Panel("time [s]", label, [make_curve("", time, errors[:, i])], [("2 %", float(small[i]))])
        for i, label in enumerate(plots.ERROR_LABELS)
    ]
    return Figure("Error coordinates", panels)


def _draw_seeds(runs: Sequence[TaskResult]) -> Figure:
    """Return a figure with three results of each run; a gap for a run that never started."""
    slope_limits = [("", 1.0 - SLOPE_TOLERANCE), ("", 1.0 + SLOPE_TOLERANCE)]
    rows = (
        ("$\\|\\hat J - J\\| / \\|J\\|$", column(runs, "explored"), [("30 %", MAX_FAITHFUL_ERROR)]),
        ("slope of r [px/s]", column(runs, "slope"), slope_limits),
        ("remaining [%]", 100.0 * column(runs, "left"), [("2 %", 100.0 * SMALL_FRACTION)]),
    )
    names, panels = [str(seed) for seed in range(len(runs))], list[Panel]()
    for style, (label, values, levels) in enumerate(rows):
        curves = [make_curve("", np.arange(len(runs)), values, style, marks=True)]
        is_log = style == 2
        panels.append(Panel("seed", label, curves, levels, log_y=is_log, categories=names))
    return Figure("All seeds", panels)
