"""Experiment `baselines`: the paper's methods compared with methods from its references.

All methods use the same scenes, start, taught target and noise of each frame, and the same time
after their exploration, if they have one. A servo with a compiled step runs on the compiled
simulation, the others with MuJoCo's arm; both simulations give the same motion. Scenes are of two
kinds: those that the built-in condition accepts (scaled condition number of J at most 40 along the
straight path), and those that it rejects, which are equally valid for other methods.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.paper.lab.calibration import ROLL_DEG, WRONG_CALIBRATION
from rcmservo.paper.lab.closed_loop import FAST_LAW
from rcmservo.paper.lab.method_statistics import MethodStatistics, run_results
from rcmservo.paper.lab.methods import (
    BROYDEN_STEP_MM,
    COMPARED_METHODS,
    RCMSERVO_METHODS,
    Method,
    UserEstimatorMethod,
)
from rcmservo.paper.lab.scene_run import Attempt
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import bars, finite, marks, percent
from rcmservo.sim import RigSettings, SceneSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.study.report import statistics
from rcmservo.study.report.statistics import Interval
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
BROYDEN = {
    "broyden": f"displacements of {BROYDEN_STEP_MM:g} mm",
    "broyden-1mm": "displacements of 1 mm",
}
POINTS = {
    "constant": "one constant 4x3 Jacobian, estimated",
    "points-exact": "exact calibration",
    "points-wrong": "wrong calibration",
}
POSES = {"pose-exact": "exact calibration", "pose-wrong": "wrong calibration"}
MEDIAN_OFFSET = 0.36
"""Horizontal distance of the median from the points of its method in a figure."""


def methods_of(settings: Settings) -> dict[str, Method]:
    """Return all methods by key, a user-defined one included."""
    own: UserEstimatorMethod | None = getattr(settings, "own", None)
    return {**COMPARED_METHODS, **({USER_ESTIMATOR: own} if own is not None else {})}


def laboratory(scene: SceneSettings) -> RigSettings:
    """Return the simulated laboratory for these scenes."""
    return RigSettings(point_noise=NOISE_PX, scene=scene)


def fixed_settings() -> dict[str, object]:
    return {"controller": FAST_LAW, "scene": SCENE, "noise": NOISE_PX}


def tasks(settings: Settings) -> list[Task]:
    compared = [
        Task(
            f"{name}-{kind}",
            partial(
                compare,
                kind=kind,
                method=method,
                scenes=getattr(settings, kind),
                duration=settings.duration,
            ),
            cost=0.2 * getattr(settings, kind),
        )
        for kind in SCENE_KINDS
        for name, method in methods_of(settings).items()
    ]
    draws = Task("draws", partial(draw_scenes, draws=settings.draws), cost=0.001 * settings.draws)
    return [*compared, draws]


def compare(kind: str, method: Method, scenes: int, duration: float) -> TaskResult:
    """Run one method in each scene of one kind."""
    attempts = (Attempt(seed, laboratory(SCENES[kind]), duration) for seed in range(scenes))
    return run_results([method.run(attempt) for attempt in attempts])


def draw_scenes(draws: int) -> TaskResult:
    """Return the worst scaled condition number of J on the path, for scenes without the limit."""
    scenes = (sample_scene_of_seed(seed, laboratory(UNLIMITED))[0] for seed in range(draws))
    return {"conditions": np.array([compute_worst_condition(scene) for scene in scenes])}


Tallies = dict[str, dict[str, MethodStatistics]]
"""Statistics of all methods, by kind of scenes and key of the method."""


def tallies(settings: Settings, results: Results) -> Tallies:
    methods = methods_of(settings)
    runs = {kind: {name: results[f"{name}-{kind}"] for name in methods} for kind in SCENE_KINDS}
    never = max(one["length"] for some in runs.values() for one in some.values())
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
    number : Callable[[MethodStatistics, MethodStatistics], Interval]
        Function that returns the number of the claim from the statistics of both methods.
    one : str
        Key of the method that the claim is about.
    other : str
        Key of the method for comparison.
    case : tuple[str, ...]
        Row and column of the case in the table of the claim.
    """

    claim: str
    number: Callable[[MethodStatistics, MethodStatistics], Interval]
    one: str
    other: str
    case: tuple[str, ...] = ()


def worst(one: MethodStatistics, other: MethodStatistics) -> Interval:
    """Return the largest final pose error (mm) of the first method; it has no interval."""
    return Interval(one.worst, -np.inf, np.inf)


def success(one: MethodStatistics, other: MethodStatistics) -> Interval:
    """Return the percentage of the scenes in which the first method arrives."""
    return one.success


def comparisons() -> Iterator[Comparison]:
    """Yield all comparisons, in the order of the report."""
    # Remark 2: the traditional image-based law [12] needs exact knowledge of C
    yield Comparison("wrong-calibration", success, "image-wrong", "image-exact")
    yield Comparison("stale-calibration", success, "image-rolled", "image-exact")
    rcmservo_names = {name: method.name for name, method in RCMSERVO_METHODS.items()}
    for name, words in rcmservo_names.items():
        yield Comparison(
            "image-based", MethodStatistics.times_as_far, name, "image-exact", (words,)
        )
    # IV-C: accuracy without a pose estimation algorithm [20], and its cost in time
    yield Comparison("flow-pose-based", MethodStatistics.times_as_far, "flow", "pose-exact")
    yield Comparison("flow-4-mm", worst, "flow", "default")
    for name, words in rcmservo_names.items():
        for other, case in POSES.items():
            yield Comparison(
                "pose-based", MethodStatistics.times_as_far, name, other, (words, case)
            )
        yield Comparison("later", MethodStatistics.later, name, "pose-exact", (words,))
    # cost of the three features [s r d] compared with four coordinates
    for name, words in rcmservo_names.items():
        for other, case in POINTS.items():
            yield Comparison("points", MethodStatistics.times_as_far, name, other, (words, case))
    # III-C: the flow rule resembles Broyden's update [15]-[17]
    for name, words in BROYDEN.items():
        yield Comparison("broyden-arrives", MethodStatistics.more_often, name, "flow", (words,))
    for name, words in BROYDEN.items():
        yield Comparison("broyden-sooner", MethodStatistics.times_as_long, name, "flow", (words,))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    found = tallies(settings, results)
    accepted = found["accepted"]
    for claim, number, one, other, case in comparisons():
        first, second = accepted[one], accepted[other]
        value = number(first, second)
        yield Measurement(
            claim,
            value.value,
            range(settings.accepted),
            interval=() if number is worst else value,
            case=case,
            remarked=claim != "pose-based" or other == "pose-wrong",
            trapped=one == "broyden",
            confirmed=value.value <= MAX_TIME_RATIO,
            one=first,
            other=second,
            both=f"{_by_kind(found, one)}, against {_by_kind(found, other)}",
            more_often=first.more_often(second),
            later=first.later(second),
            miscalibration=WRONG_CALIBRATION,
            wrong=f"; {WRONG_CALIBRATION}" if other == "points-wrong" else "",
            roll=ROLL_DEG,
            noise=NOISE_PX,
            printed=accepted["printed"],
            flow=accepted["flow"],
        )
    for claim in ("arrives", "ends-near"):
        for name in accepted:
            for kind in SCENE_KINDS:
                tally, seeds = found[kind][name], range(getattr(settings, kind))
                value = tally.success if claim == "arrives" else tally.pose
                case = (tally.name, f"scenes {kind}")
                yield Measurement(claim, value.value, seeds, interval=value, case=case, one=tally)
    left_out = int((results["draws"]["conditions"] > SCENE.max_condition).sum())
    rejected, limit = (
        percent(statistics.estimate_fraction(left_out, settings.draws)),
        SCENE.max_condition,
    )
    draws = range(settings.draws)
    yield Measurement("rejected", rejected.value, draws, interval=rejected, limit=limit)


def _by_kind(found: Tallies, name: str) -> str:
    """Return the median pose errors of one method in both kinds of scenes, as text."""
    accepted, rejected = (found[kind][name] for kind in SCENE_KINDS)
    return f"{accepted.short} {accepted.pose:.2f} mm, in rejected scenes {rejected.pose:.2f} mm"


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    found = tallies(settings, results)
    seeds, names = range(settings.accepted), list(found["accepted"])
    groups = [[n for n in names if n in some] for some in (UNCALIBRATED, DISPLACEMENT_METHODS)]
    calibrated = [n for n in names if n not in (*UNCALIBRATED, *DISPLACEMENT_METHODS)]
    label = "$\\|p_2 - p_d\\|$ [mm]"
    panels = [
        Panel("time, exploration included [s]", label, _over_time(found, some), log_y=True)
        for some in (*groups, calibrated)
    ]
    figure = Figure("Pose error, median over the scenes", panels)
    yield ReportFigure("baselines-time", seeds, figure)
    yield ReportFigure("baselines-final", seeds, Figure("Final pose errors", _final(found)))
    labels = {
        "within": "within 1 mm after [s]",
        "explored": "servoed after [s]",
        "jacobian": "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
    }
    short = [tally.short for tally in found["accepted"].values()]
    panels = [
        Panel(
            "",
            label,
            _by_method(found["accepted"], number, legend=i == 0),
            log_y=i == 2,
            categories=short,
        )
        for i, (number, label) in enumerate(labels.items())
    ]
    yield ReportFigure("baselines-costs", seeds, Figure("Times and errors of the Jacobian", panels))


def _over_time(found: Tallies, names: list[str]) -> list[Curve]:
    curves = list[Curve]()
    for style, name in enumerate(names):
        tally = found["accepted"][name]
        middle = tally.runs["middle"]
        time = tally.runs["step"] * np.arange(len(middle))
        curves.append(make_curve(tally.short, time, middle, style))
    return curves


def _final(found: Tallies) -> list[Panel]:
    """Return panels of the final pose errors and of the success rates with their intervals."""
    short, successes = [tally.short for tally in found["accepted"].values()], list[Curve]()
    for style, kind in enumerate(SCENE_KINDS):
        shift, rates = 0.2 * (style - 0.5), [tally.success for tally in found[kind].values()]
        x, values = np.arange(len(rates)) + shift, [one.value for one in rates]
        successes.append(make_curve(f"scenes {kind}", x, values, style, marks=True))
        successes.append(bars(rates, style, shift))
    panels = [
        Panel(
            "",
            f"$\\|p_2 - p_d\\|$ [mm]\nscenes {kind}",
            _by_method(found[kind], "pose"),
            levels=[("4 mm", 4.0)],
            log_y=True,
            categories=short,
        )
        for kind in SCENE_KINDS
    ]
    label, limits = "within 1 mm [% of scenes]", (-5.0, 105.0)
    return [*panels, Panel("", label, successes, y_limits=limits, categories=short)]


def _by_method(found: dict[str, MethodStatistics], number: str, legend: bool = True) -> list[Curve]:
    """Return a point per run above its method, and the medians with their intervals.

    Runs that arrived and runs that did not are separate curves, because the charts thin long
    curves.
    """
    labels = ("within 1 mm", "farther away", "median") if legend else ("", "", "")
    curves = list[Curve]()
    for style, arrived in enumerate((True, False)):
        for index, tally in enumerate(found.values()):
            values = tally.runs[number][tally.arrived == arrived]
            before: list[list[float]] = [[]] * index
            label = labels[style] if index == 0 else ""
            curves.append(marks([*before, values.tolist()], label, style))
    middles = [
        statistics.estimate_quantile(finite(tally.runs[number]), 0.5) for tally in found.values()
    ]
    x, values = np.arange(len(middles)) + MEDIAN_OFFSET, [one.value for one in middles]
    medians = make_curve(labels[2], x, values, 3, marks=True)
    return [*curves, medians, bars(middles, -1, MEDIAN_OFFSET)]
