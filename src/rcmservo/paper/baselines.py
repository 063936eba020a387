"""The paper's methods and those that it positions itself against, in the same scenes: a study.

All have the same target as it was taught and the same noise in every frame. All start at the same
joints and have the same time after their exploration, if they need one. A servo whose step is
compiled runs on the compiled twin, the others with MuJoCo's arm; both go the same way. Scenes come
in two kinds: those that our own condition accepts (scaled condition of J at most 40 along the
straight way), and those that it rejects, which are as valid for the others.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.paper.lab.attempt import Attempt
from rcmservo.paper.lab.calibration import ROLL_DEG, WRONG
from rcmservo.paper.lab.closed_loop import FAST_LAW
from rcmservo.paper.lab.methods import METHODS, OUR_METHODS, STEP_MM, Method, Own
from rcmservo.paper.lab.tally import Tally, numbers_of
from rcmservo.paper.plan import Drawn, Found, Measurement, Results, Settings, Task
from rcmservo.paper.statistics import bars, finite, marks, percent
from rcmservo.sim import RigSettings, SceneSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.study.report import statistics
from rcmservo.study.report.statistics import Interval
from rcmservo.study.row import worst_condition

KINDS = ("accepted", "rejected")
"""Kinds of scenes, by our own condition."""
SCENE = SceneSettings(room=17.0)
UNLIMITED = replace(SCENE, max_condition=1e9)
"""The same scenes without our condition."""
SCENES = {"accepted": SCENE, "rejected": replace(UNLIMITED, min_condition=SCENE.max_condition)}
NOISE_PX = 0.3
"""px of noise in every marker coordinate."""
FIXED = {"controller": FAST_LAW, "scene": SCENE, "noise": NOISE_PX}
HALF = 0.5
"""Fraction of the flow rule's time that confirms its slowness."""
OWN = "own"
"""Name of a user's own estimator among the methods."""
LEARNT = ("fast", "default", "printed", "flow", "constant", OWN)
DISPLACED = ("broyden", "broyden-1mm", "nflow", "rls", "kalman", "correntropy")
"""Methods that estimate Ĵ from displacements."""
BROYDEN = {"broyden": f"displacements of {STEP_MM:g} mm", "broyden-1mm": "displacements of 1 mm"}
POINTS = {
    "constant": "one constant 4x3 Jacobian, learnt",
    "points-exact": "exact calibration",
    "points-wrong": "wrong calibration",
}
POSES = {"pose-exact": "exact calibration", "pose-wrong": "wrong calibration"}
ASIDE = 0.36
"""Distance from a method's place at which its median is drawn."""


def methods_of(settings: Settings) -> dict[str, Method]:
    """Return every method by its name."""
    own: Own | None = getattr(settings, "own", None)
    return {**METHODS, **({OWN: own} if own is not None else {})}


def laboratory(scene: SceneSettings) -> RigSettings:
    """Return the laboratory that such scenes are drawn in."""
    return RigSettings(point_noise=NOISE_PX, scene=scene)


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
        for kind in KINDS
        for name, method in methods_of(settings).items()
    ]
    draws = Task("draws", partial(draw_scenes, draws=settings.draws), cost=0.001 * settings.draws)
    return [*compared, draws]


def compare(kind: str, method: Method, scenes: int, duration: float) -> Found:
    """Run one method in every scene of one kind."""
    attempts = (Attempt(seed, laboratory(SCENES[kind]), duration) for seed in range(scenes))
    return numbers_of([method.run(attempt) for attempt in attempts])


def draw_scenes(draws: int) -> Found:
    """Return the largest scaled condition of J on the way of scenes drawn without our limit."""
    scenes = (sample_scene_of_seed(seed, laboratory(UNLIMITED))[0] for seed in range(draws))
    return {"conditions": np.array([worst_condition(scene) for scene in scenes])}


Tallies = dict[str, dict[str, Tally]]
"""All methods by kind of scenes and name."""


def tallies(settings: Settings, results: Results) -> Tallies:
    methods = methods_of(settings)
    runs = {kind: {name: results[f"{name}-{kind}"] for name in methods} for kind in KINDS}
    never = max(one["length"] for some in runs.values() for one in some.values())
    return {
        kind: {
            name: Tally(method.name, method.short, runs[kind][name], never)
            for name, method in methods.items()
        }
        for kind in KINDS
    }


class Comparison(NamedTuple):
    """A claim on one method in the accepted scenes, or on two in the same scenes.

    Parameters
    ----------
    claim : str
        Key of the claim.
    number : Callable[[Tally, Tally], Interval]
        Number of the claim, from both.
    one : str
        Name of the method that the claim is on.
    other : str
        Name of the method that it is compared with.
    case : tuple[str, ...]
        Row and column among the cases of the claim.
    """

    claim: str
    number: Callable[[Tally, Tally], Interval]
    one: str
    other: str
    case: tuple[str, ...] = ()


def worst(one: Tally, other: Tally) -> Interval:
    """Return the largest pose error mm at the end of the first method; it has no interval."""
    return Interval(one.worst, -np.inf, np.inf)


def success(one: Tally, other: Tally) -> Interval:
    """Return the % of the scenes in which the first method arrives."""
    return one.success


def comparisons() -> Iterator[Comparison]:
    """Return all comparisons, in the order of the report."""
    # Remark 2: the traditional image-based law [12] is said to need exact knowledge of C
    yield Comparison("wrong-calibration", success, "image-wrong", "image-exact")
    yield Comparison("stale-calibration", success, "image-rolled", "image-exact")
    ours = {name: method.name for name, method in OUR_METHODS.items()}
    for name, words in ours.items():
        yield Comparison("image-based", Tally.times_as_far, name, "image-exact", (words,))
    # IV-C: what is reached without a pose estimation algorithm [20], and at which cost
    yield Comparison("flow-pose-based", Tally.times_as_far, "flow", "pose-exact")
    yield Comparison("flow-4-mm", worst, "flow", "default")
    for name, words in ours.items():
        for other, case in POSES.items():
            yield Comparison("pose-based", Tally.times_as_far, name, other, (words, case))
        yield Comparison("later", Tally.later, name, "pose-exact", (words,))
    # what the three features [s r d] give away
    for name, words in ours.items():
        for other, case in POINTS.items():
            yield Comparison("points", Tally.times_as_far, name, other, (words, case))
    # III-C: the flow rule resembles Broyden's update [15]-[17]
    for name, words in BROYDEN.items():
        yield Comparison("broyden-arrives", Tally.more_often, name, "flow", (words,))
    for name, words in BROYDEN.items():
        yield Comparison("broyden-sooner", Tally.times_as_long, name, "flow", (words,))


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
            confirmed=value.value <= HALF,
            one=first,
            other=second,
            both=f"{_apart(found, one)}, against {_apart(found, other)}",
            more_often=first.more_often(second),
            later=first.later(second),
            miscalibration=WRONG,
            wrong=f"; {WRONG}" if other == "points-wrong" else "",
            roll=ROLL_DEG,
            noise=NOISE_PX,
            printed=accepted["printed"],
            flow=accepted["flow"],
        )
    for claim in ("arrives", "ends-near"):
        for name in accepted:
            for kind in KINDS:
                tally, seeds = found[kind][name], range(getattr(settings, kind))
                value = tally.success if claim == "arrives" else tally.pose
                case = (tally.name, f"scenes {kind}")
                yield Measurement(claim, value.value, seeds, interval=value, case=case, one=tally)
    left_out = int((results["draws"]["conditions"] > SCENE.max_condition).sum())
    rejected, limit = percent(statistics.share(left_out, settings.draws)), SCENE.max_condition
    draws = range(settings.draws)
    yield Measurement("rejected", rejected.value, draws, interval=rejected, limit=limit)


def _apart(found: Tallies, name: str) -> str:
    """Return in words how one method ends in either kind of scenes."""
    accepted, rejected = (found[kind][name] for kind in KINDS)
    return (
        f"{accepted.short} {accepted.pose:.2f} mm, in scenes that our condition rejects "
        f"{rejected.pose:.2f} mm"
    )


def draw(settings: Settings, results: Results) -> Iterator[Drawn]:
    found = tallies(settings, results)
    seeds, names = range(settings.accepted), list(found["accepted"])
    learnt, displaced = ([n for n in names if n in some] for some in (LEARNT, DISPLACED))
    handed_over = [name for name in names if name not in (*LEARNT, *DISPLACED)]
    label = "$\\|p_2 - p_d\\|$ [mm]"
    panels = [
        Panel("time, exploration included [s]", label, _over_time(found, some), log_y=True)
        for some in (learnt, displaced, handed_over)
    ]
    figure = Figure("Pose error, median over the scenes", panels)
    yield Drawn("baselines-time", seeds, figure)
    yield Drawn("baselines-final", seeds, Figure("Where they end", _final(found)))
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
    yield Drawn("baselines-costs", seeds, Figure("What they cost", panels))


def _over_time(found: Tallies, names: list[str]) -> list[Curve]:
    curves = list[Curve]()
    for style, name in enumerate(names):
        tally = found["accepted"][name]
        middle = tally.runs["middle"]
        time = tally.runs["step"] * np.arange(len(middle))
        curves.append(make_curve(tally.short, time, middle, style))
    return curves


def _final(found: Tallies) -> list[Panel]:
    """Draw the final pose errors, and the successes of each method with their intervals."""
    short, successes = [tally.short for tally in found["accepted"].values()], list[Curve]()
    for style, kind in enumerate(KINDS):
        shift, shares = 0.2 * (style - 0.5), [tally.success for tally in found[kind].values()]
        x, values = np.arange(len(shares)) + shift, [one.value for one in shares]
        successes.append(make_curve(f"scenes {kind}", x, values, style, marks=True))
        successes.append(bars(shares, style, shift))
    panels = [
        Panel(
            "",
            f"$\\|p_2 - p_d\\|$ [mm]\nscenes {kind}",
            _by_method(found[kind], "pose"),
            levels=[("4 mm", 4.0)],
            log_y=True,
            categories=short,
        )
        for kind in KINDS
    ]
    label, limits = "within 1 mm [% of scenes]", (-5.0, 105.0)
    return [*panels, Panel("", label, successes, y_limits=limits, categories=short)]


def _by_method(found: dict[str, Tally], number: str, legend: bool = True) -> list[Curve]:
    """Draw a number of every run as a point above its method, and the medians with their intervals.

    Runs that arrived and those that did not have curves of their own, as a longer one would be
    thinned.
    """
    labels = ("within 1 mm", "farther away", "median") if legend else ("", "", "")
    curves = list[Curve]()
    for style, arrived in enumerate((True, False)):
        for place, tally in enumerate(found.values()):
            values = tally.runs[number][tally.arrived == arrived]
            before: list[list[float]] = [[]] * place
            label = labels[style] if place == 0 else ""
            curves.append(marks([*before, values.tolist()], label, style))
    middles = [statistics.quantile(finite(tally.runs[number]), 0.5) for tally in found.values()]
    places, values = np.arange(len(middles)) + ASIDE, [one.value for one in middles]
    return [*curves, make_curve(labels[2], places, values, 3, marks=True), bars(middles, -1, ASIDE)]
