"""The paper's methods beside those that it positions itself against: a study, in which all have the
same scenes, the same target as it was shown, and the same noise in every frame.

All start at the same joints and have the same time after their exploration, if they need one. A
servo whose step is compiled runs on the compiled twin, the others before MuJoCo's arm; both go the
same way. Scenes come in two kinds, told apart everywhere: those that our own condition accepts
(scaled condition of J at most 40 along the straight way), and those that it rejects, which are as
valid for the others.
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
from rcmservo.experiments.harness.lab.attempt import Attempt, Conditions
from rcmservo.experiments.harness.lab.methods import METHODS, Method, Own
from rcmservo.experiments.harness.lab.tally import (
    SCENES,
    MethodRuns,
    Scenes,
    Tallies,
    Tally,
    runs_of,
)
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import bars, marks, percent
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.sim import SceneSettings
from rcmservo.sim.rig import drawn
from rcmservo.study.row import NEAR, worst_condition
from rcmservo.study.told import statistics
from rcmservo.study.told.statistics import Interval

PAPER = "[12], [15]-[17], [20]"
OWN = "own"
"""The name of a user's own estimator among the methods."""
UNLIMITED = 1e9
"""A condition that no scene is rejected for."""


@dataclass(frozen=True)
class Settings:
    """Which scenes, and under which conditions."""

    accepted: int = 50
    """Scenes that our condition accepts, of seeds from 0 on."""
    rejected: int = 25
    """Scenes that it rejects, of seeds from 0 on."""
    draws: int = 1000
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

    def scenes(self, scenes: Scenes) -> SceneSettings:
        """What scenes of a kind are drawn from."""
        hard = replace(self.unlimited, min_condition=self.scene.max_condition)
        return self.scene if scenes == "accepted" else hard

    def seeds(self, scenes: Scenes) -> range:
        """Of the scenes of a kind."""
        return range(self.accepted if scenes == "accepted" else self.rejected)


@dataclass(frozen=True, eq=False)
class DrawnConditions:
    """The conditions of scenes drawn without asking for one."""

    conditions: JsonFloats
    """The largest scaled condition of J along the straight way, for each scene."""


def tasks(settings: Settings) -> list[Task]:
    compared = [
        Task(
            f"{method}-{scenes}",
            partial(compare, settings=settings, method=method, scenes=scenes),
            cost=0.2 * len(settings.seeds(scenes)),
        )
        for scenes in SCENES
        for method in settings.methods
    ]
    return [*compared, Task("draws", partial(draw, settings=settings), cost=0.001 * settings.draws)]


def compare(folder: Path, settings: Settings, method: str, scenes: Scenes) -> MethodRuns:
    """One method in every scene of one kind."""
    del folder
    chosen, conditions = settings.methods[method], settings.conditions
    laboratory, seeds = (
        conditions.laboratory(settings.scenes(scenes)),
        settings.seeds(scenes),
    )
    return runs_of([chosen.run(Attempt(seed, laboratory, conditions)) for seed in seeds])


def draw(folder: Path, settings: Settings) -> DrawnConditions:
    """The condition of scenes drawn without asking for one."""
    del folder
    laboratory = settings.conditions.laboratory(settings.unlimited)
    scenes = (drawn(seed, laboratory)[0] for seed in range(settings.draws))
    return DrawnConditions(np.array([worst_condition(scene) for scene in scenes]))


def chapter(settings: Settings, results: Results) -> Chapter:
    found = tallies(settings, results)
    claims = [
        *against_image_based.claims(found),
        *against_pose_based.claims(found),
        *against_points.claims(found),
        *against_broyden.claims(found),
        *(arrives(found, name, scenes) for name in settings.methods for scenes in SCENES),
        *(ends_near(found, name, scenes) for name in settings.methods for scenes in SCENES),
        rejected_share(settings, results.of(DrawnConditions, "draws")),
    ]
    return Chapter(claims, [_over_time(found), _final(found), _costs(found)])


def tallies(settings: Settings, results: Results) -> Tallies:
    """Every method in both kinds of scenes."""
    runs = {
        scenes: {name: results.of(MethodRuns, f"{name}-{scenes}") for name in settings.methods}
        for scenes in SCENES
    }
    never = max(one.length for some in runs.values() for one in some.values())

    def of(scenes: Scenes) -> dict[str, Tally]:
        return {
            name: Tally(method.name, method.short, runs[scenes][name], never)
            for name, method in settings.methods.items()
        }

    return Tallies(of("accepted"), of("rejected"), settings.seeds("accepted"), settings.conditions)


def arrives(found: Tallies, name: str, scenes: Scenes) -> Claim:
    tally = found.of(scenes)[name]
    return Claim(
        "at least 95 % of the scenes end within 1 mm of the target's pose",
        OURS,
        tally.success.value,
        "% of scenes",
        ">=",
        95.0,
        tally.runs.seeds,
        interval=tally.success[1:],
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
        tally.pose.value,
        "mm",
        "<=",
        NEAR,
        tally.runs.seeds,
        interval=tally.pose[1:],
        case=(tally.name, f"scenes {scenes}"),
        figure="baselines-final",
    )


def rejected_share(settings: Settings, draws: DrawnConditions) -> Claim:
    limit = settings.scene.max_condition
    left_out = int((draws.conditions > limit).sum())
    share = percent(statistics.share(left_out, settings.draws))
    return Claim(
        f"our condition on scenes (at most {limit:g}) leaves out no more than a fifth of the "
        "valid draws",
        OURS,
        share.value,
        "% of draws",
        "<=",
        20.0,
        range(settings.draws),
        interval=share[1:],
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
    tally = found.accepted[name]
    middle = tally.runs.middle
    return curve(tally.short, tally.runs.step * np.arange(len(middle)), middle, style)


def _final(found: Tallies) -> Shown:
    short = found.short
    panels = [
        Panel(
            "",
            f"$\\|p_2 - p_d\\|$ [mm]\nscenes {scenes}",
            _by_method(found.of(scenes), lambda runs: runs.pose),
            levels=[("4 mm", 4.0)],
            log_y=True,
            categories=short,
        )
        for scenes in SCENES
    ]
    shares = [
        one
        for style, scenes in enumerate(SCENES)
        for one in _successes(list(found.of(scenes).values()), f"scenes {scenes}", style)
    ]
    panels.append(
        Panel("", "within 1 mm [% of scenes]", shares, y_limits=(-5.0, 105.0), categories=short)
    )
    caption = (
        "Root mean square pose error over the last second, a point per scene, and how many scenes "
        "ended within 1 mm: in scenes that our own condition accepts, and in those that it "
        f"rejects. {LINES} C: calibration matrix."
    )
    return Shown("baselines-final", PAPER, caption, found.seeds, Figure("Where they end", panels))


def _successes(tallies: Sequence[Tally], label: str, style: int) -> list[Curve]:
    """The share of each method with its interval, beside the shares in the other scenes."""
    aside, shares = 0.2 * (style - 0.5), [tally.success for tally in tallies]
    x = np.arange(len(shares)) + aside
    points = curve(label, x, [one.value for one in shares], style, marks=True)
    return [points, bars(shares, style, aside)]


def _costs(found: Tallies) -> Shown:
    numbers: dict[str, Callable[[MethodRuns], Floats]] = {
        "within 1 mm after [s]": lambda runs: runs.within,
        "servoed after [s]": lambda runs: runs.explored,
        "$\\|\\hat{J} - J\\| / \\|J\\|$ [1]": lambda runs: runs.jacobian,
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
        "In the accepted scenes: time until first within 1 mm, the exploration included, the "
        "exploration alone, and the scaled error of Ĵ (median over the time after the "
        "exploration), which is looked at where a method runs before MuJoCo's arm and has a Ĵ. "
        f"{LINES} Laws on poses with a given C do not explore; those on features and points with "
        "a given C explore for the imaged RCM alone."
    )
    return Shown("baselines-costs", PAPER, caption, found.seeds, Figure("What they cost", panels))


LINES = "The lines are intervals of 95 %, those beside the points of the median."


def _by_method(
    tallies: dict[str, Tally], number: Callable[[MethodRuns], Floats], legend: bool = True
) -> list[Curve]:
    """One number of every run as a point over its method, arrived and not, and the medians with
    their intervals."""
    labels = ("within 1 mm", "farther away", "median") if legend else ("", "", "")
    points = [
        _points(tally, number, place, arrived, labels[style] if place == 0 else "")
        for style, arrived in enumerate((True, False))
        for place, tally in enumerate(tallies.values())
    ]
    middles = [_median(number(tally.runs)) for tally in tallies.values()]
    places = np.arange(len(middles)) + ASIDE
    values = [one.value for one in middles]
    return [*points, curve(labels[2], places, values, 3, marks=True), bars(middles, -1, ASIDE)]


def _points(
    tally: Tally, number: Callable[[MethodRuns], Floats], place: int, arrived: bool, label: str
) -> Curve:
    """One number of the runs of a method that arrived, or of those that did not: a curve of their
    own, as a longer one would be thinned."""
    values: list[float] = number(tally.runs)[tally.arrived == arrived].tolist()
    before: list[list[float]] = [[]] * place
    return marks([*before, values], label, 0 if arrived else 1)


ASIDE = 0.36
"""Of a method's place, where its median is drawn."""


def _median(values: Floats) -> Interval:
    """Of the runs that have this number."""
    return statistics.quantile(values[np.isfinite(values)], 0.5)


EXPERIMENT = Experiment(
    name="baselines",
    title="Beside other methods",
    about="The paper's methods and ours beside Broyden's update [15]-[17], four others that learn "
    "from displacements (normalised flow, least squares, Kalman's filter, correntropy), the "
    "traditional image-based law with a calibration [12], pose-based control [20], and "
    "point-based laws on all four marker coordinates, in the same scenes with the same noise and "
    "k = 2; only our default has its own k = 8. A run arrives if it is within 1 mm over its last "
    "second, by the truth. Intervals are of 95 %, and comparisons in pairs: scene by scene.",
    whole=Settings(),
    quick=Settings(2, 1, draws=100, conditions=Conditions(duration=6.0)),
    tasks=tasks,
    chapter=chapter,
)


def beside(own: Own) -> Experiment[Settings]:
    """The experiment with a user's own estimator among the methods."""
    whole, quick = (replace(one, own=own) for one in (EXPERIMENT.whole, EXPERIMENT.quick))
    return replace(EXPERIMENT, whole=whole, quick=quick)
