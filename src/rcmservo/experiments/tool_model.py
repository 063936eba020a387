"""What the tool's model costs: a rigid shaft, our default, or the paper's constant λ, when the real
tool is rigid.

Once without motion, with Ĵ from the true a, and once in closed loops that know the tool by either
model.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.cameras import PINHOLE, true_parameters
from rcmservo.experiments.harness.lab.closed_loop import NOISE
from rcmservo.experiments.harness.lab.witness import Trial, settle, why_not
from rcmservo.experiments.harness.statistics import known, marks, median, told
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.estimators.projection import feature_jacobian
from rcmservo.method.features import about
from rcmservo.method.tool import RigidTool, ScaledTool, Tool
from rcmservo.sim import Rig, RigSettings

SPACING = 30.0
"""mm between the markers on the real tool."""

LABELS = ["rigid shaft", "constant λ"]


@dataclass(frozen=True)
class Settings:
    """Random scenes without motion, and closed loops."""

    scenes: tuple[int, ...] = tuple(range(60))
    """Seeds of scenes judged without motion."""
    loops: tuple[int, ...] = tuple(range(10))
    """Seeds of closed loops."""
    duration: float = 20.0
    """s of a loop."""


@dataclass(frozen=True)
class Modelled:
    """Ĵ from the true a with one model of the tool."""

    along: float
    """∂d/∂ρ px/mm."""
    whole: float
    """Scaled error of Ĵ."""
    row: float
    """Error of its d row."""


@dataclass(frozen=True)
class ToolScene:
    """Both models in one scene."""

    true: float
    """True ∂d/∂ρ px/mm."""
    rigid: Modelled
    """With a rigid shaft."""
    constant: Modelled
    """With a constant λ that is right at the pose itself, so that both predict the same m₂."""


@dataclass(frozen=True)
class ToolScenes:
    """Both models in every scene."""

    found: list[ToolScene]
    """One for each seed."""


@dataclass(frozen=True)
class ToolLoops:
    """The same closed loop with either model known to the servo."""

    rigid: Trial
    """The servo takes the tool as it is, a rigid shaft."""
    constant: Trial
    """The servo takes λ as constant; it is right at home."""


def tasks(settings: Settings) -> list[Task]:
    loops = [
        Task(f"loop-{seed}", partial(loop, settings=settings, seed=seed)) for seed in settings.loops
    ]
    return [Task("scenes", partial(scenes, settings=settings)), *loops]


def tools(p1: Floats) -> tuple[Tool, Tool]:
    """Both models of one tool, alike with marker 1 at p1 (3,) mm."""
    return RigidTool(SPACING), ScaledTool(1.0 + SPACING / float(np.linalg.norm(p1)))


def scenes(folder: Path, settings: Settings) -> ToolScenes:
    """What `scene` finds of every scene."""
    del folder
    return ToolScenes([scene(seed) for seed in settings.scenes])


def scene(seed: int) -> ToolScene:
    """Ĵ from the true a with either tool model."""
    rig = Rig(seed, RigSettings(scene=PINHOLE), pictures=False)
    a, o_c = true_parameters(rig)
    q = rig.scene.start
    p1: Floats = rig.body.points(q)[0]
    J, m = rig.truth.jacobian(q, o_c), about(rig.truth.pixels(q), o_c)
    depth: Floats = J[2]
    n = p1 / np.linalg.norm(p1)

    def modelled(tool: Tool) -> Modelled:
        J_hat = feature_jacobian(a, p1, m, tool.shaft)
        off: Floats = J_hat[2] - depth
        return Modelled(
            along=float(J_hat[2] @ n),
            whole=rig.truth.jacobian_error(J_hat, q, o_c),
            row=float(np.linalg.norm(off) / np.linalg.norm(depth)),
        )

    return ToolScene(float(depth @ n), *(modelled(tool) for tool in tools(p1)))


def loop(folder: Path, settings: Settings, seed: int) -> ToolLoops:
    """The same closed loop with either tool model known to the servo. λ is right at home."""
    del folder
    laboratory = RigSettings(tool=RigidTool(SPACING), point_noise=NOISE)
    home = Rig(seed, laboratory, pictures=False)
    known = tools(home.body.points(home.scene.start)[0])
    return ToolLoops(*(settle(seed, laboratory, settings.duration, tool)[0] for tool in known))


def chapter(settings: Settings, results: Results) -> Chapter:
    found = results.of(ToolScenes, "scenes").found
    loops = results.all(ToolLoops, "loop", settings.loops)
    claims = [
        right_jacobian(settings, found),
        right_sign(settings, found),
        settles(settings, loops),
    ]
    return Chapter(claims, [_scene_figure(settings, found), _loop_figure(settings, loops)])


def right_jacobian(settings: Settings, found: list[ToolScene]) -> Claim:
    rigid, constant = (
        median([one.whole for one in some])
        for some in ([one.rigid for one in found], [one.constant for one in found])
    )
    return Claim(
        "with λ a known constant and the true a, Ĵ is right on a rigid tool: median scaled error",
        "lambda",
        constant,
        "of ‖J‖",
        "<=",
        0.1,
        settings.scenes,
        remark=f"its d row is off by {median([one.constant.row for one in found]):.2g} of itself, "
        "though λ is right at the pose itself",
        detail=f"rigid shaft: {rigid:.1g}",
        figure="tool-model",
        trap="T2",
        confirmed=constant > 0.1 >= rigid,
    )


def right_sign(settings: Settings, found: list[ToolScene]) -> Claim:
    wrong = float(np.mean([one.true * one.constant.along < 0.0 for one in found]))
    return Claim(
        "with λ a known constant and the true a, ∂d/∂ρ has the right sign: share of scenes",
        "lambda",
        1.0 - wrong,
        "of the scenes",
        ">=",
        0.95,
        settings.scenes,
        remark=f"it is wrong in {wrong:.0%} of the scenes: a constant λ lets the spacing grow "
        "with the insertion, and a rigid shaft does not"
        if wrong > 0.0
        else "",
        figure="tool-model",
        trap="T2",
        confirmed=wrong >= 0.25,
    )


def settles(settings: Settings, loops: list[ToolLoops]) -> Claim:
    rigid, constant = [one.rigid for one in loops], [one.constant for one in loops]
    settled = [sum(trial.settled for trial in some) for some in (rigid, constant)]
    wrong = [median(known(trial.jacobian for trial in some)) for some in (rigid, constant)]
    return Claim(
        "a servo that takes λ as constant settles on a rigid tool all the same: share of the runs",
        "lambda",
        settled[1] / len(loops),
        "of the runs",
        ">=",
        0.9,
        settings.loops,
        follows=True,
        remark=f"Ĵ is wrong by {told(wrong[1])} meanwhile (rigid shaft {told(wrong[0])})",
        detail=f"settled {settled[1]} of {len(loops)} (rigid shaft {settled[0]}), "
        f"{_settled_words(constant)} ({_settled_words(rigid)}){why_not(constant)}",
        figure="tool-loops",
        trap="T2",
        confirmed=wrong[1] > 2.0 * wrong[0],
    )


def _settled_words(trials: list[Trial]) -> str:
    settled = [trial for trial in trials if trial.settled]
    time = median(known(trial.settle_time for trial in settled))
    pose = median([trial.pose for trial in settled])
    return f"median after {told(time, '.1f')} s, pose error {told(pose, '.2g')} mm"


def _scene_figure(settings: Settings, found: list[ToolScene]) -> Shown:
    true = [one.true for one in found]
    ends = [min(true), max(true)]
    models = ([one.rigid for one in found], [one.constant for one in found])
    modelled = [
        curve(LABELS[style], true, [one.along for one in some], style, marks=True)
        for style, some in enumerate(models)
    ]
    derivative = Panel(
        "true $\\partial d / \\partial \\rho$ [px/mm]",
        "modelled $\\partial d / \\partial \\rho$ [px/mm]",
        [curve("right", ends, ends, -1), *modelled],
        levels=[("", 0.0)],
    )
    errors = marks([[one.whole for one in some] for some in models])
    label = "$\\|\\hat{J} - J\\| / \\|J\\|$, scaled [1]"
    caption = (
        "Ĵ from the true a in random scenes, with either model of the tool: how d changes with "
        "the insertion (points below the line at 0 on one side and above it on the other have "
        "the wrong sign), and the error of all of Ĵ."
    )
    panels = [derivative, Panel("", label, [errors], categories=LABELS)]
    figure = Figure("What a constant λ does to the Jacobian", panels, columns=2)
    return Shown("tool-model", "II-B", caption, settings.scenes, figure)


def _loop_figure(settings: Settings, loops: list[ToolLoops]) -> Shown:
    models = ([one.rigid for one in loops], [one.constant for one in loops])
    numbers = {
        "settled after [s]": [[one.settle_time for one in some] for some in models],
        "pose error of marker 2 [mm]": [[one.pose for one in some] for some in models],
        "median error of $\\hat{J}$ [1]": [[one.jacobian for one in some] for some in models],
    }
    panels = [
        Panel("", label, [marks(groups)], log_y=i > 0, categories=LABELS)
        for i, (label, groups) in enumerate(numbers.items())
    ]
    caption = (
        "Closed loops with k = 2, one mark for each seed; runs that did not settle have no time."
    )
    figure = Figure("Either tool model in the loop", panels, columns=3)
    return Shown("tool-loops", "II-B", caption, settings.loops, figure)


EXPERIMENT = Experiment(
    name="tool-model",
    title="Sensitivity: the tool's model",
    about="A rigid shaft, our default, beside the paper's constant λ, on a rigid tool.",
    whole=Settings(),
    quick=Settings(scenes=tuple(range(8)), loops=(0,), duration=8.0),
    tasks=tasks,
    chapter=chapter,
)
