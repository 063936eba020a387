"""Comparison of the paper's methods with methods from its references.

Experiment `baselines`. All methods use the same scenes, start, taught target and noise of each
frame, and the same time after their exploration, if they have one. A servo with a compiled step
runs on the compiled simulation, the others with MuJoCo's arm; both give the same motion.
Scenes are of two kinds: those that the built-in condition accepts (scaled condition number of J at
most 40 along the straight path), and those that it rejects, which are equally valid for other
methods.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.calibration import ROLL_DEG, WRONG_CALIBRATION
from rcmservo.paper.lab.method_statistics import MethodStatistics, summarise_runs
from rcmservo.paper.lab.methods import BROYDEN_STEP_MM, COMPARED_METHODS, RCMSERVO_METHODS, Method
from rcmservo.paper.lab.scene_run import Attempt
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import (
    curve_per_label,
    finite,
    group_marks,
    interval_bars,
    to_percent,
)
from rcmservo.sim import RigSettings, SceneSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.study.report.statistics import Interval, estimate_fraction, estimate_quantile
from rcmservo.study.row import compute_worst_condition

SCENE_KINDS = ("accepted", "rejected")
"""Kinds of scenes, by the built-in condition on scenes."""
SCENE = SceneSettings(room=17.0)
UNLIMITED = replace(SCENE, max_condition=1e9)
"""The same scenes without the condition."""
SCENES = {"accepted": SCENE, "rejected": replace(UNLIMITED, min_condition=SCENE.max_condition)}
NOISE_PX = 0.3
"""Standard deviation (px) of the noise in each marker coordinate."""
MAX_TIME_RATIO = 0.5
"""Largest ratio of Broyden's time to the flow rule's that confirms the pitfall T7."""
USER_ESTIMATOR = "own"
"""Key of a user-defined estimator among the methods."""
UNCALIBRATED = ("fast", "default", "printed", "flow", "constant", USER_ESTIMATOR)
"""Methods without a calibration, except those in `DISPLACEMENT_METHODS`."""
DISPLACEMENT_METHODS = ("broyden", "broyden-1mm", "nflow", "rls", "kalman", "correntropy")
"""Methods that estimate Ĵ from successive displacements."""
BROYDEN_CASES = {
    "broyden": f"displacements of {BROYDEN_STEP_MM:g} mm",
    "broyden-1mm": "displacements of 1 mm",
}
POSE_CASES = {"pose-exact": "exact calibration", "pose-wrong": "wrong calibration"}
POINT_CASES = {
    "constant": "one constant 4x3 Jacobian, estimated",
    "points-exact": "exact calibration",
    "points-wrong": "wrong calibration",
}
MEDIAN_OFFSET = 0.36
"""Horizontal distance of the median from the points of its method in a figure."""
POSE_ERROR_LABEL = "$\\|p_2 - p_d\\|$ [mm]"


def list_methods(settings: Settings) -> dict[str, Method]:
    """Return all methods by key, a user-defined one included."""
    user_method: Method | None = getattr(settings, USER_ESTIMATOR, None)
    return {**COMPARED_METHODS, **({USER_ESTIMATOR: user_method} if user_method else {})}


def laboratory(scene: SceneSettings) -> RigSettings:
    """Return the simulated laboratory for these scenes."""
    return RigSettings(point_noise=NOISE_PX, scene=scene)


def tasks(settings: Settings) -> list[Task]:
    comparisons = list[Task]()
    for kind, (name, method) in product(SCENE_KINDS, list_methods(settings).items()):
        scenes, duration = getattr(settings, kind), settings.duration
        work = partial(run_in_scenes, kind=kind, method=method, scenes=scenes, duration=duration)
        comparisons.append(Task(f"{name}-{kind}", work, cost=0.2 * scenes))
    work = partial(draw_scenes, draws=settings.draws)
    return [*comparisons, Task("draws", work, cost=0.001 * settings.draws)]


def run_in_scenes(kind: str, method: Method, scenes: int, duration: float) -> TaskResult:
    """Run one method in each scene of one kind."""
    attempts = (Attempt(seed, laboratory(SCENES[kind]), duration) for seed in range(scenes))
    return summarise_runs([method.run(attempt) for attempt in attempts])


def draw_scenes(draws: int) -> TaskResult:
    """Return the worst scaled condition number of J on the path, for scenes without the limit."""
    scenes = (sample_scene_of_seed(seed, laboratory(UNLIMITED))[0] for seed in range(draws))
    return {"conditions": np.array([compute_worst_condition(scene) for scene in scenes])}


StatisticsByKind = dict[str, dict[str, MethodStatistics]]
"""Statistics of all methods, by kind of scenes and key of the method."""


def compute_statistics(settings: Settings, results: Results) -> StatisticsByKind:
    methods = list_methods(settings)
    runs = {kind: {name: results[f"{name}-{kind}"] for name in methods} for kind in SCENE_KINDS}
    never = max(one["length"] for kind in SCENE_KINDS for one in runs[kind].values())
    return {
        kind: {
            name: MethodStatistics(method.name, method.short, runs[kind][name], never)
            for name, method in methods.items()
        }
        for kind in SCENE_KINDS
    }


class Comparison(NamedTuple):
    """A claim about a method in the accepted scenes, possibly relative to another method.

    Parameters
    ----------
    claim : str
        Key of the claim.
    estimate : Callable[[MethodStatistics, MethodStatistics], Interval]
        Function that returns the number of the claim from the statistics of both methods.
    method : str
        Key of the method that the claim is about.
    other : str
        Key of the method for comparison.
    case : tuple[str, ...]
        Row and column of the case in the table of the claim.
    """

    claim: str
    estimate: Callable[[MethodStatistics, MethodStatistics], Interval]
    method: str
    other: str
    case: tuple[str, ...] = ()


def largest_error(method: MethodStatistics, other: MethodStatistics) -> Interval:
    """Return the largest final pose error (mm) of the first method; it has no interval."""
    return Interval(method.worst, -np.inf, np.inf)


def success_rate(method: MethodStatistics, other: MethodStatistics) -> Interval:
    """Return the percentage of the scenes in which the first method arrives."""
    return method.success


def list_comparisons() -> Iterator[Comparison]:
    """Yield all comparisons, in the order of the report."""
    times_as_far, more_often = MethodStatistics.times_as_far, MethodStatistics.more_often
    # Remark 2: the traditional image-based law [12] needs exact knowledge of C
    yield Comparison("wrong-calibration", success_rate, "image-wrong", "image-exact")
    yield Comparison("stale-calibration", success_rate, "image-rolled", "image-exact")
    names = {key: method.name for key, method in RCMSERVO_METHODS.items()}
    for key, name in names.items():
        yield Comparison("image-based", times_as_far, key, "image-exact", (name,))
    # IV-C: accuracy without a pose estimation algorithm [20], and its cost in time
    yield Comparison("flow-pose-based", times_as_far, "flow", "pose-exact")
    yield Comparison("flow-4-mm", largest_error, "flow", "default")
    for key, name in names.items():
        for other, case in POSE_CASES.items():
            yield Comparison("pose-based", times_as_far, key, other, (name, case))
        yield Comparison("later", MethodStatistics.later, key, "pose-exact", (name,))
    # cost of the three features [s r d] compared with four coordinates
    for key, name in names.items():
        for other, case in POINT_CASES.items():
            yield Comparison("points", times_as_far, key, other, (name, case))
    # III-C: the flow rule resembles Broyden's update [15]-[17]
    for key, case in BROYDEN_CASES.items():
        yield Comparison("broyden-arrives", more_often, key, "flow", (case,))
    for key, case in BROYDEN_CASES.items():
        yield Comparison("broyden-sooner", MethodStatistics.times_as_long, key, "flow", (case,))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    statistics = compute_statistics(settings, results)
    for comparison in list_comparisons():
        yield measure_comparison(comparison, statistics, settings)
    claims = "arrives", "ends-near"
    for claim, name, kind in product(claims, statistics["accepted"], SCENE_KINDS):
        method, seeds = statistics[kind][name], range(getattr(settings, kind))
        value = method.success if claim == "arrives" else method.pose
        case = (method.name, f"scenes {kind}")
        yield Measurement(claim, value.value, seeds, interval=value, case=case, method=method)
    limit, draws = SCENE.max_condition, range(settings.draws)
    count = int((results["draws"]["conditions"] > limit).sum())
    rejected = to_percent(estimate_fraction(count, settings.draws))
    yield Measurement("rejected", rejected.value, draws, interval=rejected, limit=limit)


def measure_comparison(
    comparison: Comparison, statistics: StatisticsByKind, settings: Settings
) -> Measurement:
    claim, estimate, key, other_key, case = comparison
    accepted = statistics["accepted"]
    method, other = accepted[key], accepted[other_key]
    value = estimate(method, other)
    errors = [describe_errors(statistics, name) for name in (key, other_key)]
    return Measurement(
        claim,
        value.value,
        range(settings.accepted),
        interval=() if estimate is largest_error else value,
        case=case,
        remarked=claim != "pose-based" or other_key == "pose-wrong",
        trapped=key == "broyden",
        confirmed=value.value <= MAX_TIME_RATIO,
        method=method,
        other=other,
        both=", against ".join(errors),
        more_often=method.more_often(other),
        later=method.later(other),
        miscalibration=WRONG_CALIBRATION,
        wrong=f"; {WRONG_CALIBRATION}" if other_key == "points-wrong" else "",
        roll=ROLL_DEG,
        noise=NOISE_PX,
        printed=accepted["printed"],
        flow=accepted["flow"],
    )


def describe_errors(statistics: StatisticsByKind, name: str) -> str:
    """Return the median pose errors of one method in both kinds of scenes, as text."""
    accepted, rejected = (statistics[kind][name] for kind in SCENE_KINDS)
    return f"{accepted.short} {accepted.pose:.2f} mm, in rejected scenes {rejected.pose:.2f} mm"


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    statistics = compute_statistics(settings, results)
    seeds, accepted = range(settings.accepted), statistics["accepted"]
    calibrated = [name for name in accepted if name not in (*UNCALIBRATED, *DISPLACEMENT_METHODS)]
    panels = list[Panel]()
    for group in (UNCALIBRATED, DISPLACEMENT_METHODS, calibrated):
        names = {name: accepted[name].short for name in accepted if name in group}
        curves = curve_per_label(names, lambda name: median_over_time(accepted[name]))
        label = "time, exploration included [s]"
        panels.append(Panel(label, POSE_ERROR_LABEL, curves, log_y=True))
    figure = Figure("Pose error, median over the scenes", panels)
    yield PaperFigure("baselines-time", seeds, figure)
    figure = Figure("Final pose errors", draw_final_errors(statistics))
    yield PaperFigure("baselines-final", seeds, figure)
    labels = {
        "within": "within 1 mm after [s]",
        "explored": "servoed after [s]",
        "jacobian": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    }
    short = [method.short for method in accepted.values()]
    panels = list[Panel]()
    for name, label in labels.items():
        curves, is_log = mark_runs(accepted, name, legend=name == "within"), name == "jacobian"
        panels.append(Panel("", label, curves, log_y=is_log, categories=short))
    yield PaperFigure("baselines-costs", seeds, Figure("Times and errors of the Jacobian", panels))


def median_over_time(method: MethodStatistics) -> tuple[Floats, Floats]:
    """Return times (n,) in s, and the median pose errors (n,) in mm."""
    errors = method.runs["middle"]
    return method.runs["step"] * np.arange(len(errors)), errors


def draw_final_errors(statistics: StatisticsByKind) -> list[Panel]:
    """Return panels of the final pose errors and of the success rates with their intervals."""
    short = [method.short for method in statistics["accepted"].values()]
    panels, success_curves = list[Panel](), list[Curve]()
    for style, (kind, methods) in enumerate(statistics.items()):
        label, curves = f"{POSE_ERROR_LABEL}\nscenes {kind}", mark_runs(methods, "pose")
        levels = [("4 mm", 4.0)]
        panels.append(Panel("", label, curves, levels, log_y=True, categories=short))
        shift, rates = 0.2 * (style - 0.5), [method.success for method in methods.values()]
        x, values = np.arange(len(rates)) + shift, [rate.value for rate in rates]
        success_curves.append(make_curve(f"scenes {kind}", x, values, style, marks=True))
        success_curves.append(interval_bars(rates, style, shift))
    label, limits = "within 1 mm [% of scenes]", (-5.0, 105.0)
    return [*panels, Panel("", label, success_curves, y_limits=limits, categories=short)]


def mark_runs(methods: dict[str, MethodStatistics], name: str, legend: bool = True) -> list[Curve]:
    """Return a point per run above its method, and the medians with their intervals.

    Runs that arrived and runs that did not are separate curves, because the charts thin long
    curves.
    """
    labels = ("within 1 mm", "farther away", "median") if legend else ("", "", "")
    curves = list[Curve]()
    for style, arrived in enumerate((True, False)):
        for index, method in enumerate(methods.values()):
            values = method.runs[name][method.arrived == arrived]
            empty_groups: list[list[float]] = [[]] * index
            label = labels[style] if index == 0 else ""
            curves.append(group_marks([*empty_groups, values.tolist()], label, style))
    medians = [estimate_quantile(finite(method.runs[name]), 0.5) for method in methods.values()]
    x, values = np.arange(len(medians)) + MEDIAN_OFFSET, [middle.value for middle in medians]
    median_curve = make_curve(labels[2], x, values, 3, marks=True)
    return [*curves, median_curve, interval_bars(medians, -1, MEDIAN_OFFSET)]
