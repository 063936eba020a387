"""The paper's methods beside those that it positions itself against, in the same scenes with the
same noise.

All start at the same joints, are shown the same target and have the same time after their
exploration, if they need one. Scenes come in two kinds, told apart everywhere: those that our own
condition accepts (scaled condition of J at most 40 along the straight way), and those that it
rejects, which are as valid for the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments import (
    against_broyden,
    against_image_based,
    against_points,
    against_pose_based,
)
from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.methods import METHODS, Conditions, Method, Own, attempted
from rcmservo.experiments.harness.lab.tally import SCENES, Scenes, Tallies, Tally
from rcmservo.experiments.harness.lab.witness import Trial
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import known, marks, median, share
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.method.controller import scaled
from rcmservo.sim import Rig, RigSettings, SceneSettings

PAPER = "[12], [15]-[17], [20]"
OWN = "own"
"""The name of a user's own estimator among the methods."""
UNLIMITED = 1e9
"""A condition that no scene is rejected for."""

NEAR = 1.0
"""mm within which a method is to end, median over the scenes."""


@dataclass(frozen=True)
class Settings:
    """Which scenes, and under which conditions."""

    seeds: tuple[int, ...] = tuple(range(20))
    """Of scenes that our condition accepts."""
    rejected: tuple[int, ...] = (0, 20, 38, 43, 50, 59, 67, 74, 81, 86, 87, 97)
    """Seeds whose scene our condition rejects, all below 100; a test draws them anew."""
    draws: int = 100
    """Scenes drawn without our condition, to count those that it rejects."""
    scene: SceneSettings = field(default_factory=lambda: SceneSettings(room=17.0))
    """What scenes are drawn from; ``max_condition`` is our condition."""
    conditions: Conditions = field(default_factory=Conditions)
    """The same for every method."""
    own: Own | None = None
    """A user's own estimator, to stand beside the others."""

    @property
    def methods(self) -> dict[str, Method]:
        """Every method by its name."""
        return {**METHODS, **({OWN: self.own} if self.own is not None else {})}

    @property
    def unlimited(self) -> SceneSettings:
        """The same scenes without our condition."""
        return replace(self.scene, max_condition=UNLIMITED)


@dataclass(frozen=True)
class MethodTrials:
    """One method in all scenes of one kind."""

    trials: list[Trial]
    """One for each scene."""


@dataclass(frozen=True)
class DrawnConditions:
    """The conditions of scenes drawn without asking for one."""

    conditions: list[float]
    """The largest scaled condition of J along the straight way, for each scene."""


def tasks(settings: Settings) -> list[Task]:
    seeds: dict[Scenes, Sequence[int]] = {
        "accepted": settings.seeds,
        "rejected": settings.rejected,
    }
    compared = [
        Task(
            f"{method}-{scenes}",
            partial(compare, settings=settings, method=method, scenes=scenes, seeds=seeds[scenes]),
            cost=1.2 * len(seeds[scenes]),
        )
        for scenes in SCENES
        for method in settings.methods
    ]
    return [*compared, Task("draws", partial(draw, settings=settings), cost=0.2 * settings.draws)]


def compare(
    folder: Path, settings: Settings, method: str, scenes: Scenes, seeds: Sequence[int]
) -> MethodTrials:
    """One method in every scene of one kind."""
    del folder
    scene = settings.scene if scenes == "accepted" else settings.unlimited
    chosen, conditions = settings.methods[method], settings.conditions
    return MethodTrials([attempted(chosen, scene, seed, conditions) for seed in seeds])


def draw(folder: Path, settings: Settings) -> DrawnConditions:
    """The condition of scenes drawn without asking for one."""
    del folder
    return DrawnConditions(
        [worst_condition(settings.unlimited, seed) for seed in range(settings.draws)]
    )


def worst_condition(scene: SceneSettings, seed: int) -> float:
    """The largest scaled condition of J along the straight way of a drawn scene."""
    rig = Rig(seed, RigSettings(scene=scene), pictures=False)
    o_c = rig.truth.imaged_rcm()
    return max(float(np.linalg.cond(scaled(rig.truth.jacobian(q, o_c)))) for q in rig.scene.way)


def chapter(settings: Settings, results: Results) -> Chapter:
    found = tallies(settings, results)
    claims = [
        *against_image_based.claims(found),
        *against_pose_based.claims(found),
        *against_points.claims(found),
        *against_broyden.claims(found),
        *(settles(found, name, scenes) for name in settings.methods for scenes in SCENES),
        *(ends_near(found, name, scenes) for name in settings.methods for scenes in SCENES),
        rejected_share(settings, results.of(DrawnConditions, "draws")),
    ]
    return Chapter(claims, [_over_time(found), _final(found), _costs(found)])


def tallies(settings: Settings, results: Results) -> Tallies:
    """Every method in both kinds of scenes."""
    longest = settings.conditions.duration

    def trials(name: str, scenes: Scenes) -> list[Trial]:
        return results.of(MethodTrials, f"{name}-{scenes}").trials

    def of(scenes: Scenes) -> dict[str, Tally]:
        return {
            name: Tally(method.name, method.short, trials(name, scenes), longest)
            for name, method in settings.methods.items()
        }

    return Tallies(of("accepted"), of("rejected"), settings.seeds, settings.conditions)


def settles(found: Tallies, name: str, scenes: Scenes) -> Claim:
    tally = found.of(scenes)[name]
    return Claim(
        "at least 95 % of the scenes settle",
        OURS,
        tally.settled,
        "% of scenes",
        ">=",
        95.0,
        [trial.seed for trial in tally.trials],
        case=(tally.name, f"scenes {scenes}"),
        remark=tally.failures,
        detail=tally.words,
        figure="baselines-final",
    )


def ends_near(found: Tallies, name: str, scenes: Scenes) -> Claim:
    tally = found.of(scenes)[name]
    return Claim(
        "the median scene ends within 1 mm of the target's pose",
        OURS,
        tally.pose,
        "mm",
        "<=",
        NEAR,
        [trial.seed for trial in tally.trials],
        case=(tally.name, f"scenes {scenes}"),
        figure="baselines-final",
    )


def rejected_share(settings: Settings, draws: DrawnConditions) -> Claim:
    limit = settings.scene.max_condition
    return Claim(
        f"our condition on scenes (at most {limit:g}) leaves out no more than a fifth of the "
        "valid draws",
        OURS,
        100.0 * share(condition > limit for condition in draws.conditions),
        "% of draws",
        "<=",
        20.0,
        range(settings.draws),
        detail="these scenes are shown apart",
        figure="baselines-final",
    )


LEARNT = ("fast", "default", "printed", "flow", "constant", OWN)
DISPLACED = ("broyden", "broyden-1mm", "nflow", "rls", "kalman", "correntropy")
"""Those that learn Ĵ from displacements."""


def _over_time(found: Tallies) -> Shown:
    learnt, displaced = (
        [name for name in found.accepted if name in names] for names in (LEARNT, DISPLACED)
    )
    handed_over = [name for name in found.accepted if name not in (*LEARNT, *DISPLACED)]

    def panel(names: Sequence[str]) -> Panel:
        curves = [_median_over_time(found, name, style) for style, name in enumerate(names)]
        return Panel("time, exploration included [s]", "$\\|p_2 - p_d\\|$ [mm]", curves, log_y=True)

    panels = [panel(learnt), panel(displaced), panel(handed_over)]
    caption = (
        "Median pose error by the truth over the accepted scenes, those that failed included. "
        "Above, methods without a calibration, and then those of them that learn from one "
        "displacement after the other; below, those with one. C is the calibration matrix."
    )
    figure = Figure("Pose error, median over the scenes", panels)
    return Shown("baselines-time", PAPER, caption, found.seeds, figure)


def _median_over_time(found: Tallies, name: str, style: int) -> Curve:
    """The median over runs; one that ended earlier stays where it ended."""
    trials = found.accepted[name].trials
    longest = max(len(trial.poses) for trial in trials)
    rows = [[*trial.poses, *[trial.poses[-1]] * (longest - len(trial.poses))] for trial in trials]
    time = trials[0].step * np.arange(longest)
    return curve(found.accepted[name].short, time, np.median(rows, axis=0), style)


def _final(found: Tallies) -> Shown:
    short = found.short
    panels = [
        Panel(
            "",
            f"$\\|p_2 - p_d\\|$ [mm]\nscenes {scenes}",
            _by_method(found.of(scenes), lambda trial: trial.pose),
            levels=[("4 mm", 4.0)],
            log_y=True,
            categories=short,
        )
        for scenes in SCENES
    ]
    shares = [
        curve(f"scenes {scenes}", range(len(short)), _settled(found, scenes), style, marks=True)
        for style, scenes in enumerate(SCENES)
    ]
    panels.append(
        Panel("", "settled [% of scenes]", shares, y_limits=(-5.0, 105.0), categories=short)
    )
    caption = (
        "Root mean square pose error at the end, a point per scene, and how many scenes settled: "
        "in scenes that our own condition accepts, and in those that it rejects. C: calibration "
        "matrix."
    )
    return Shown("baselines-final", PAPER, caption, found.seeds, Figure("Where they end", panels))


def _settled(found: Tallies, scenes: Scenes) -> list[float]:
    return [tally.settled for tally in found.of(scenes).values()]


def _costs(found: Tallies) -> Shown:
    numbers: dict[str, Callable[[Trial], float | None]] = {
        "settled after [s]": lambda trial: trial.settle_time,
        "explored for [s]": lambda trial: trial.explored_at,
        "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]": lambda trial: trial.jacobian,
    }
    panels = [
        Panel(
            "",
            label,
            _by_method(found.accepted, number, legend=i == 0),
            log_y=i == 2,
            categories=found.short,
        )
        for i, (label, number) in enumerate(numbers.items())
    ]
    caption = (
        "In the accepted scenes: time until settled, the exploration included, the exploration "
        "alone, and the scaled error of Ĵ (median over the time after the exploration). Laws on "
        "points and poses with a given C do not explore; the image-based law with a given C "
        "explores for the imaged RCM alone."
    )
    return Shown("baselines-costs", PAPER, caption, found.seeds, Figure("What they cost", panels))


def _by_method(
    tallies: dict[str, Tally], number: Callable[[Trial], float | None], legend: bool = True
) -> list[Curve]:
    """One number of every run as a point over its method: settled and not, and the medians."""

    def of(settled: bool) -> list[list[float | None]]:
        return [
            [number(trial) if trial.settled is settled else None for trial in tally.trials]
            for tally in tallies.values()
        ]

    middles = [median(known(map(number, tally.trials))) for tally in tallies.values()]
    places = np.arange(len(middles)) + 0.36
    labels = ("settled", "not settled", "median") if legend else ("", "", "")
    return [
        marks(of(True), labels[0], 0),
        marks(of(False), labels[1], 1),
        curve(labels[2], places, middles, 3, marks=True),
    ]


EXPERIMENT = Experiment(
    name="baselines",
    title="Beside other methods",
    about="The paper's methods and ours beside Broyden's update [15]-[17], four others that learn "
    "from displacements (normalised flow, least squares, Kalman's filter, correntropy), the "
    "traditional image-based law with a calibration [12], pose-based control [20], and "
    "point-based laws on all four marker coordinates, in the same scenes with the same noise and "
    "k = 2; only our default has its own k = 8. Settled is judged on the true features, without "
    "noise.",
    whole=Settings(),
    quick=Settings(seeds=(0, 1), rejected=(0,), draws=10, conditions=Conditions(duration=8.0)),
    tasks=tasks,
    chapter=chapter,
)


def beside(own: Own) -> Experiment[Settings]:
    """The experiment with a user's own estimator among the methods."""
    whole, quick = (replace(one, own=own) for one in (EXPERIMENT.whole, EXPERIMENT.quick))
    return replace(EXPERIMENT, whole=whole, quick=quick)
