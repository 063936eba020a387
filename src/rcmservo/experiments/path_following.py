"""Following a path that is given as moving reference pixels, as in [10], with neither calibration
nor feed-forward.

Marker 1 is to go round a circle in space. The reference is the circle's picture in the true camera,
as [10] computes it by its forward model; the servo is told these pixels and nothing else. A law
without feed-forward stays behind by v/k.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.closed_loop import FAST_LAW, servo_for
from rcmservo.experiments.harness.lab.methods import FLOW_RULE, OUR_METHODS, Learner
from rcmservo.experiments.harness.lab.path import PathWay, Trace, circle
from rcmservo.experiments.harness.lab.witness import EVERY, laboratory
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Floats
from rcmservo.loop.clock import ticks
from rcmservo.method.controller import SaturatedController
from rcmservo.method.features import SCALE
from rcmservo.servo.servo import State
from rcmservo.sim import SceneSettings

METHODS: Mapping[str, Learner] = {**OUR_METHODS, "flow": FLOW_RULE}

AT_START = 0.15
"""Scaled feature error at which the first point of a path counts as reached."""


@dataclass(frozen=True)
class Settings:
    """A circle about the target, gone round once."""

    seeds: tuple[int, ...] = tuple(range(10))
    """Of the scenes."""
    scene: SceneSettings = field(default_factory=lambda: SceneSettings(room=17.0))
    """What the scenes are drawn from."""
    noise: float = 0.3
    """px."""
    approach: float = 20.0
    """s allowed for the way to the circle's first point, after the exploration."""
    controller: SaturatedController = FAST_LAW
    """Of every method but our default; it has no feed-forward."""
    radius: float = 10.0
    """mm."""
    period: float = 30.0
    """s."""

    @property
    def speed(self) -> float:
        """v mm/s on the circle."""
        return 2.0 * np.pi * self.radius / self.period

    def law(self, method: Learner) -> SaturatedController:
        """A method's own controller, or that of all."""
        return method.controller or self.controller


@dataclass(frozen=True)
class Following:
    """One method on one path."""

    seed: int
    """Of the scene."""
    way: PathWay | None
    """None if it did not get round."""
    cause: str
    """Why it did not get round, in words; empty if it did."""


@dataclass(frozen=True)
class Followings:
    """One method on the path of every scene."""

    trials: list[Following]
    """One for each scene."""


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(method, partial(follow_all, settings=settings, method=method), len(settings.seeds))
        for method in METHODS
    ]


def follow_all(folder: Path, settings: Settings, method: str) -> Followings:
    """One estimator on the path of every scene."""
    del folder
    return Followings([follow(settings, METHODS[method], seed) for seed in settings.seeds])


def follow(settings: Settings, method: Learner, seed: int) -> Following:
    """Explore, go to the path's first point, then servo to reference pixels that move along it."""
    rig, plant = laboratory(seed, settings.scene, settings.noise)
    servo = servo_for(rig.settings, method.estimator, method.exploration, settings.law(method))
    trace = Trace(circle(rig, settings.radius, settings.period))
    state, target = servo.init(), trace.path.reference(0.0)
    servo.warm_up()
    plant.enable()
    longest = servo.exploration.max_time + settings.approach + settings.period
    for k, _ in enumerate(ticks(plant.clock, duration=longest)):
        seen = plant.read()
        if trace.began is None and at_start(state):
            trace.began = seen.now
        if trace.began is not None:
            time = (seen.now - trace.began) / 1e9
            if time > settings.period:
                break
            target = trace.path.reference(time)
            if k % EVERY == 0:
                trace.look(time)
        state = servo.step(state, seen, target)
        plant.send(state.command)
        if state.phase in (Phase.PAUSED, Phase.FAULT):
            break
    way = trace.way()
    where = "before its start" if trace.began is None else "on the path"
    cause = state.cause.stopping or f"time ran out {where}"
    return Following(seed, way, "" if way else cause)


def at_start(state: State) -> bool:
    """Whether the servo sees the tool at the path's first point."""
    return state.phase is Phase.SERVO and bool(np.max(np.abs(state.delta) / SCALE) < AT_START)


@dataclass(frozen=True)
class PathsFollowed:
    """One method on all paths."""

    settings: Settings
    """Which circle it was, and in which scenes."""
    method: Learner
    """What followed the paths."""
    trials: list[Following]
    """One for each scene."""

    @property
    def gain(self) -> float:
        """k, 1/s."""
        return self.settings.law(self.method).gain

    @property
    def lag(self) -> float:
        """v/k mm, by which a law without feed-forward stays behind."""
        return self.settings.speed / self.gain

    @property
    def ways(self) -> list[PathWay]:
        return [trial.way for trial in self.trials if trial.way is not None]

    @property
    def failures(self) -> str:
        causes = Counter(trial.cause for trial in self.trials if trial.way is None)
        total = len(self.trials)
        return "; ".join(f"{n} of {total} not completed: {cause}" for cause, n in causes.items())


def chapter(settings: Settings, results: Results) -> Chapter:
    found = [
        PathsFollowed(settings, method, results.of(Followings, name).trials)
        for name, method in METHODS.items()
    ]
    claims = [gets_round(one) for one in found]
    claims += [
        claim(one) for claim in (lags_by_v_over_k, keeps_beside) for one in found if one.ways
    ]
    return Chapter(claims, [_figure(settings, found)])


def gets_round(found: PathsFollowed) -> Claim:
    settings = found.settings
    return Claim(
        "the tool follows moving reference pixels round the whole path, as in [10], in every scene",
        OURS,
        100.0 * len(found.ways) / len(found.trials),
        "% of scenes",
        ">=",
        100.0,
        settings.seeds,
        case=(found.method.name, ""),
        remark=found.failures,
        detail=f"circle of {settings.radius:g} mm in {settings.period:g} s, "
        f"{settings.speed:.1f} mm/s",
        figure="path",
    )


def lags_by_v_over_k(found: PathsFollowed) -> Claim:
    settings, ways = found.settings, found.ways
    worst = max(way.max for way in ways)
    return Claim(
        "it stays within 1.5 v/k of the reference, v/k being the lag of a law without feed-forward",
        OURS,
        median([way.rms for way in ways]),
        "mm rms",
        "<=",
        1.5 * found.lag,
        settings.seeds,
        case=(found.method.name, ""),
        remark=found.failures,
        detail=f"median over the scenes; v/k = {found.lag:.2f} mm; in a scene at most "
        f"{median([way.max for way in ways]):.2f} mm (median), {worst:.2f} mm (worst), "
        f"{median([way.pixels_rms for way in ways]):.1f} px rms in the picture",
        figure="path",
    )


def keeps_beside(found: PathsFollowed) -> Claim:
    settings, ways = found.settings, found.ways
    beside = median([way.beside for way in ways])
    start = median([float(way.errors[0]) for way in ways])
    late = f"the start counts too, where the tool is still {start:.1f} mm from the reference"
    return Claim(
        "it keeps within 0.3 mm of the path, but for its lag",
        OURS,
        beside,
        "mm rms",
        "<=",
        0.3,
        settings.seeds,
        case=(found.method.name, ""),
        remark="; ".join(filter(None, (found.failures, late if beside > 0.3 else ""))),
        detail=f"median over the scenes, after a lag of {median([way.lag for way in ways]):.2f} s; "
        f"1/k is {1.0 / found.gain:.2f} s",
        figure="path",
    )


def _figure(settings: Settings, found: list[PathsFollowed]) -> Shown:
    done = [one for one in found if one.ways]
    first = next((trial for one in done for trial in one.trials if trial.way), None)
    caption = (
        f"Left, marker 1 in the picture of scene {first.seed if first else '–'}; right, how far it "
        "is from the moving reference, median over the scenes."
    )
    pictures, lags = _pictures(done), {one.gain: one.lag for one in found}
    panels = [
        Panel("u [px]", "v [px], downwards", pictures, y_limits=_downwards(pictures)),
        Panel(
            "time on the path [s]",
            "$\\|p_1 - p_{ref}\\|$ [mm]",
            [_errors(one, style) for style, one in enumerate(done)],
            levels=[(f"v/k, k = {k:g}", lag) for k, lag in lags.items()],
        ),
    ]
    figure = Figure("Following a path", panels, columns=2)
    return Shown("path", "[10]", caption, settings.seeds, figure)


def _pictures(done: list[PathsFollowed]) -> list[Curve]:
    """The reference of the first way, and the first way of every method."""
    references = [_picture("reference", one.ways[0].wanted, -1) for one in done[:1]]
    return references + [
        _picture(one.method.short, one.ways[0].seen, style) for style, one in enumerate(done)
    ]


def _errors(found: PathsFollowed, style: int) -> Curve:
    """Median over the scenes."""
    shortest = min(len(way.errors) for way in found.ways)
    middle = np.median([way.errors[:shortest] for way in found.ways], axis=0)
    return curve(found.method.short, found.ways[0].times[:shortest], middle, style)


def _picture(label: str, pixels: Floats, style: int) -> Curve:
    return curve(label, pixels[:, 0], pixels[:, 1], style)


def _downwards(curves: Sequence[Curve]) -> tuple[float, float]:
    """Limits of an axis of v, which grows downwards as in the picture."""
    v = [value for one in curves for value in one.y if value is not None] or [0.0]
    return max(v) + 3.0, min(v) - 3.0


EXPERIMENT = Experiment(
    name="path-following",
    title="Following a path",
    about="Path following by moving reference pixels, as in [10]: our projection-based method, "
    "our default and the paper's flow rule, without a calibration and without feed-forward.",
    whole=Settings(),
    quick=Settings(seeds=(0,), approach=8.0, radius=5.0, period=15.0),
    tasks=tasks,
    chapter=chapter,
)
