"""Regulation of the paper, for either estimator, from errors of exactly [40°, 80 px, 60 px].

The tool explores from Ĵ = 0, returns to the start with the paper's gains, and moves to the taught
target. A run is faithful only if Ĵ is within 30 % of J after the exploration and the error of r
falls by k b = 1 px/s ± 30 % while saturated: a Ĵ that is too small multiplies k, so that a fast run
with it does not reproduce the paper.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.figures import plots
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick
from rcmservo.paper.lab.closed_loop import (
    PAPER_SCENES,
    POINT_NOISE_PX,
    PRINTED_LAW,
    Arrived,
    closed_loop,
    make_servo,
    read_task_record,
)
from rcmservo.paper.plan import (
    Measurement,
    NotMeasured,
    ReportFigure,
    Results,
    Settings,
    Task,
    TaskResult,
)
from rcmservo.paper.statistics import column, ends_of, fraction, median, rms
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
        Law of the return to the start and of the motion to the target.
    """

    estimator: Estimator
    exploration: Exploration
    pictures: bool
    duration: float
    half_way: bool = False
    controller: SaturatedController = PRINTED_LAW

    @property
    def servo(self) -> Servo:
        """Servo of this regulation."""
        return make_servo(REGULATION_LABORATORY, self.estimator, self.exploration, self.controller)

    def tasks(self, prefix: str, seeds: Iterable[int]) -> list[Task]:
        """Return one task per seed."""
        cost = (0.35 if self.pictures else 0.03) * (self.duration + 80.0)
        return Task.per_seed(prefix, partial(regulate, plan=self), seeds, cost, in_folder=True)


def regulate(folder: Path, seed: int, plan: Regulation) -> TaskResult:
    """Explore, return to the start, regulate; return the cause at the end and `from_record`."""
    with closed_loop(folder, seed, REGULATION_LABORATORY, plan.pictures, plan.servo) as loop:
        scene = loop.rig.scene
        home, _ = loop.teach(scene.start)
        target, p_d = loop.teach(scene.target)
        loop.rig.place(scene.midpoint if plan.half_way else scene.start)
        tick = loop.explore(home)
        if not tick.state.explored:
            return {
                "cause": tick.state.cause.stop_sentence or Cause.NOT_EXPLORED.value,
                "began": None,
            }
        tick = loop.last(home, RETURN_TIMEOUT_S, tick.state, done=Arrived())
        began = loop.elapsed()
        for count, newest in enumerate(loop.stage(target, plan.duration, tick.state)):
            tick = newest
            if count == round(100 * NOTICED_S):
                loop.snapshot("initial.png", target, tick.state, _words("initial", tick))
        loop.snapshot("final.png", target, tick.state, _words("final", tick))
    found = from_record(read_task_record(folder), began, p_d, plan.controller)
    return {"cause": tick.state.cause.stop_sentence, **found}


def _words(when: str, tick: Tick) -> str:
    s, r, d = np.abs(tick.state.delta) * plots.DISPLAY_UNITS
    return f"{when}: |ds| {s:.2f} deg  |dr| {r:.2f} px  |dd| {d:.2f} px"


def from_record(rows: Record, began: float, p_d: Floats, law: SaturatedController) -> TaskResult:
    """Return the results of a run whose motion to the target started at the time `began` (s).

    ``explored``, ``at_start`` and ``at_end`` are scaled errors of Ĵ. ``initial`` is |Δy| (3,) and
    ``left`` the largest remaining fraction of it. ``slope`` is the rate (px/s) at which the error
    of r falls while saturated. ``pose`` is the rms of ‖p₂ − p_d‖ (mm) over the last second, and
    ``model`` the rms (px) of π (34) − m₁.
    """
    error = rows.truth["jacobian_error"][:, 0]
    judged = np.flatnonzero(np.isfinite(error))
    explored = int(np.argmax([phase not in ("IDLE", "ACQUIRE") for phase in rows.phase]))
    new = rows.new_frames(began + NOTICED_S)
    sizes, time = np.abs(rows.ticks["delta"][new]), rows.time[new] - began
    small = (sizes < SMALL_FRACTION * INITIAL_ERRORS).all(axis=1)
    pose = np.linalg.norm(rows.truth["p2"] - p_d, axis=1)
    flow_error, flow_noise = _flow_errors(rows, began + NOTICED_S)
    return {
        "began": began,
        "explored": error[explored],
        "at_start": error[judged[rows.time[judged] >= began][0]],
        "at_end": error[judged[-1]],
        "initial": np.mean(sizes[:6], axis=0),
        "slope": slope(time, sizes[:, 1], law.bounds[1]),
        "left": np.max(
            np.sqrt(np.mean(sizes[time > time[-1] - END_S] ** 2, axis=0)) / INITIAL_ERRORS
        ),
        "time_to_small": time[np.argmax(small)] if small.any() else None,
        "pose": rms(pose[rows.time > rows.time[-1] - 1.0]),
        "model": _model_error(rows, began),
        "flow_error": flow_error,
        "flow_noise": flow_noise,
    }


def slope(time: Floats, size: Floats, bound: float) -> float | None:
    """Return the rate (units/s) at which an error falls above 1.2 b; None if it never was there."""
    saturated = size > 1.2 * bound
    if saturated.sum() < 10:
        return None
    return float(-np.polyfit(time[saturated], size[saturated], 1)[0])


def _model_error(rows: Record, began: float) -> float | None:
    """Return the rms distance (px) between π and m₁ from the start on; None without a model."""
    new = rows.new_frames(began)
    error = rows.ticks["model"][new, :2] - (rows.ticks["points"][new, :2] - rows.ticks["o_c"][new])
    return rms(np.linalg.norm(error, axis=1)) if np.isfinite(error).all() else None


def _flow_errors(rows: Record, since: float) -> tuple[float, float]:
    """Return the rms of ω (35) − ẏ, averaged over 1 s, and the noise of ω, relative to ẏ."""
    y_dot, omega = (
        flow * plots.DISPLAY_UNITS for flow in plots.compute_flows(rows, rows.new_frames(since))
    )
    known = np.isfinite(y_dot).all(axis=1) & np.isfinite(omega).all(axis=1)
    y_dot, omega = y_dot[known], omega[known]  # a pause at the end invalidates the estimate
    mean = moving_means(y_dot)
    return (
        rms(moving_means(omega) - mean) / rms(mean),
        rms(np.diff(omega, axis=0)) / rms(np.diff(y_dot, axis=0)),
    )


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


def failure(run: TaskResult) -> str:
    """Return why a run failed or is not faithful, as text; empty if it succeeded."""
    if run["began"] is None or run["cause"]:
        return run["cause"]
    if not run["explored"] <= MAX_FAITHFUL_ERROR:
        return f"error of Ĵ {run['explored']:.0%} after exploration"
    if run["slope"] is None or abs(run["slope"] - 1.0) > SLOPE_TOLERANCE:
        return f"r fell by {run['slope'] or np.nan:.2f} px/s"
    return "" if is_small(run) else f"{run['left']:.1%} of an error remains"


def succeeds(runs: Sequence[TaskResult], seeds: Sequence[int], case: str) -> Measurement:
    """Return the measurement that the errors fall as in the paper."""
    successful = [run for run in runs if not failure(run)]
    poses = column(successful, "pose")
    left = max(100.0 * column(successful, "left"), default=np.nan)
    words = [
        f"largest remaining error {format_finite(left, '.1f')} %, pose error median "
        f"{format_finite(median(poses))} mm, worst {format_finite(max(poses, default=np.nan))} mm"
    ]
    if started_runs(runs):
        errors = np.array([run["initial"] for run in started_runs(runs)]) - INITIAL_ERRORS
        s, r, d = np.max(np.abs(errors), axis=0) * plots.DISPLAY_UNITS
        s_0, r_0, d_0 = INITIAL_ERRORS * plots.DISPLAY_UNITS
        words = [
            f"initial errors [{s_0:.0f}°, {r_0:.0f} px, {d_0:.0f} px], which the servo measures "
            f"about its o_c to within {s:.2f}°, {r:.1f} px, {d:.1f} px",
            *words,
        ]
    pairs = zip(seeds, runs, strict=True)
    words += [f"seed {seed}: {why}" for seed, run in pairs if (why := failure(run))]
    value = 100.0 * fraction(not failure(run) for run in runs)
    return Measurement("succeeds", value, seeds, case=(case,), words="; ".join(words))


def measured_runs(
    runs: Sequence[TaskResult], seeds: Sequence[int], what: str, key: str
) -> tuple[list[int], Floats, str]:
    """Return seeds and values of the runs that have a result, and a remark on those without.

    Raises
    ------
    NotMeasured
        If no run has the result.
    """
    values = column(runs, key)
    known = np.isfinite(values)
    if not known.any():
        raise NotMeasured(f"{what}, in any run", float("nan"))
    without = int((~known).sum())
    missing = f"; not measured in {without} of {len(runs)} runs" if without else ""
    return [seed for seed, one in zip(seeds, known, strict=True) if one], values[known], missing


def approximates(runs: Sequence[TaskResult], seeds: Sequence[int], case: str) -> Measurement:
    """Return the measurement that Ĵ approximates J after the exploration."""
    known, errors, missing = measured_runs(runs, seeds, "the error of Ĵ", "explored")
    return Measurement(
        "approximates",
        median(errors),
        known,
        case=(case,),
        worst=errors.max(),
        start=median(column(started_runs(runs), "at_start")),
        end=median(column(started_runs(runs), "at_end")),
        missing=missing,
    )


def falls_by_k_b(runs: Sequence[TaskResult], seeds: Sequence[int], case: str) -> Measurement:
    """Return the measurement that a saturated error falls by k b."""
    known, slopes, missing = measured_runs(runs, seeds, "the slope of r", "slope")
    value, ends = median(np.abs(slopes - 1.0)), ends_of(slopes)
    return Measurement("falls-by-k-b", value, known, case=(case,), ends=ends, missing=missing)


def figures(settings: Settings, results: Results, case: str) -> Iterator[ReportFigure]:
    """Yield Fig. 7 or 8 (images) and 9 or 10 (errors) of seed 0, and a figure of all seeds."""
    seeds, folder = range(settings.seeds), results.folders["seed-0"]
    pictures = [folder / name for name in ("initial.png", "final.png")]
    if all(path.exists() for path in pictures):
        yield ReportFigure("pictures", [0], pictures=pictures)
    yield ReportFigure("errors", [0], errors_figure(read_task_record(folder), results["seed-0"]))
    chart = _seeds_figure(results.per_seed("seed", seeds), [str(seed) for seed in seeds])
    yield ReportFigure("seeds", seeds, chart, words={"case": case})


def start_time(run: TaskResult) -> float:
    """Return the time (s) at which the motion to the target started; 0 if it did not."""
    return run["began"] or 0.0


def errors_figure(rows: Record, run: TaskResult, until: float = float("inf")) -> Figure:
    """Return a figure of the error magnitudes over `until` s from the start: Fig. 9 and 10."""
    began = start_time(run)
    selected = (rows.time >= began + NOTICED_S) & (rows.time <= began + until)
    sizes = np.abs(rows.ticks["delta"][selected]) * plots.DISPLAY_UNITS
    ends = INITIAL_ERRORS * SMALL_FRACTION * plots.DISPLAY_UNITS
    panels = [
        Panel(
            "time [s]",
            name,
            [make_curve("", rows.time[selected] - began, sizes[:, i])],
            levels=[("2 %", float(ends[i]))],
        )
        for i, name in enumerate(plots.ERROR_LABELS)
    ]
    return Figure("Error coordinates", panels)


def _seeds_figure(runs: Sequence[TaskResult], names: list[str]) -> Figure:
    """Return a figure with three results of each run; a gap for a run that never started."""
    numbers = {
        "$\\|\\hat J - J\\| / \\|J\\|$": (column(runs, "explored"), [("30 %", MAX_FAITHFUL_ERROR)]),
        "slope of r [px/s]": (
            column(runs, "slope"),
            [("", 1.0 - SLOPE_TOLERANCE), ("", 1.0 + SLOPE_TOLERANCE)],
        ),
        "remaining [%]": (100.0 * column(runs, "left"), [("2 %", 100.0 * SMALL_FRACTION)]),
    }
    panels = [
        Panel(
            "seed",
            label,
            [make_curve("", np.arange(len(names)), values, i, marks=True)],
            levels,
            log_y=i == 2,
            categories=names,
        )
        for i, (label, (values, levels)) in enumerate(numbers.items())
    ]
    return Figure("All seeds", panels)
