"""Experiment `tool-model`: a rigid shaft, which is the default, or the paper's constant λ.

The models are compared without motion, with Ĵ from the true a, and in closed loops in which the
servo uses either model.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.estimation.projection_rule import feature_jacobian
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.features import shift_to_rcm
from rcmservo.geometry.tool import RigidTool, ScaledTool, Tool
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.cameras import PINHOLE, true_parameters
from rcmservo.paper.lab.closed_loop import POINT_NOISE_PX
from rcmservo.paper.lab.evaluation import count_settled, failure_reasons, settle
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, finite, mark_panels, marks, median
from rcmservo.sim import Rig, RigSettings
from rcmservo.study.report.statistics import format_finite

SPACING_MM = 30.0
"""Distance (mm) between the markers on the simulated tool."""
MODELS = {"rigid": "rigid shaft", "constant": "constant λ"}
RIGID_TOOL_LABORATORY = RigSettings(tool=RigidTool(SPACING_MM), point_noise=POINT_NOISE_PX)


def fixed_settings() -> dict[str, object]:
    return {"laboratory": RIGID_TOOL_LABORATORY}


def tasks(settings: Settings) -> list[Task]:
    loops = Task.per_seed("loop", partial(loop, settings=settings), range(settings.loops))
    return [Task("scenes", partial(scenes, settings=settings)), *loops]


def tools(p1: Floats) -> tuple[Tool, Tool]:
    """Return both models of a tool; they agree for marker 1 at `p1` (3,) in mm."""
    return RigidTool(SPACING_MM), ScaledTool(1.0 + SPACING_MM / float(np.linalg.norm(p1)))


def scenes(settings: Settings) -> TaskResult:
    """Return the results of `scene` for each scene."""
    return {"scenes": [scene(seed) for seed in range(settings.scenes)]}


def scene(seed: int) -> TaskResult:
    """Return the true ∂d/∂ρ (px/mm), and the errors of Ĵ from the true a with either tool model.

    The constant λ is exact at the pose itself, so that both models predict the same m₂. ``along``
    is ∂d/∂ρ (px/mm), ``whole`` the scaled error of Ĵ, ``row`` the relative error of its d row.
    """
    rig = Rig(seed, RigSettings(scene=PINHOLE), pictures=False)
    a, o_c = true_parameters(rig)
    q = rig.scene.start
    p1: Floats = rig.body.points(q)[0]
    J, m = rig.truth.jacobian(q, o_c), shift_to_rcm(rig.truth.pixels(q), o_c)
    depth: Floats = J[2]
    n = p1 / np.linalg.norm(p1)
    found: dict[str, object] = {"true": depth @ n}
    for model, tool in zip(MODELS, tools(p1), strict=True):
        J_hat = feature_jacobian(a, p1, m, tool.struct)
        found[model] = {
            "along": J_hat[2] @ n,
            "whole": rig.truth.jacobian_error(J_hat, q, o_c),
            "row": np.linalg.norm(J_hat[2] - depth) / np.linalg.norm(depth),
        }
    return found


def loop(settings: Settings, seed: int) -> TaskResult:
    """Return the trial of one seed with either tool model in the servo; λ is exact at the start."""
    home = Rig(seed, RIGID_TOOL_LABORATORY, pictures=False)
    known = tools(home.body.points(home.scene.start)[0])
    trials = [settle(seed, RIGID_TOOL_LABORATORY, settings.duration, tool)[0] for tool in known]
    return dict(zip(MODELS, trials, strict=True))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    found, seeds = results["scenes"]["scenes"], range(settings.scenes)
    rigid, constant = (median(column(found, model, "whole")) for model in MODELS)
    row = median(column(found, "constant", "row"))
    confirmed = constant > 0.1 >= rigid
    yield Measurement("jacobian", constant, seeds, confirmed=confirmed, row=row, rigid=rigid)
    opposite = float(np.mean(column(found, "true") * column(found, "constant", "along") < 0.0))
    yield Measurement(
        "sign",
        1.0 - opposite,
        seeds,
        remarked=opposite > 0.0,
        confirmed=opposite >= 0.25,
        wrong=opposite,
    )
    trials = _trials(settings, results)
    counts = {model: count_settled(some) for model, some in trials.items()}
    errors = {m: median(finite(column(some, "jacobian"))) for m, some in trials.items()}
    yield Measurement(
        "settles",
        counts["constant"] / settings.loops,
        range(settings.loops),
        confirmed=errors["constant"] > 2.0 * errors["rigid"],
        errors={model: format_finite(error) for model, error in errors.items()},
        counts=counts,
        words={model: _settled_words(some) for model, some in trials.items()},
        reasons=failure_reasons(trials["constant"]),
    )


def _trials(settings: Settings, results: Results) -> dict[str, list[TaskResult]]:
    loops = results.per_seed("loop", range(settings.loops))
    return {model: [one[model] for one in loops] for model in MODELS}


def _settled_words(trials: list[TaskResult]) -> str:
    successful = [trial for trial in trials if not trial["why_not"]]
    time, pose = (median(column(successful, name)) for name in ("settle_time", "pose"))
    return (
        f"median after {format_finite(time, '.1f')} s, pose error {format_finite(pose, '.2g')} mm"
    )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    found, labels = results["scenes"]["scenes"], list(MODELS.values())
    true = column(found, "true")
    ends = [true.min(), true.max()]
    modelled = [
        make_curve(label, true, column(found, model, "along"), style, marks=True)
        for style, (model, label) in enumerate(MODELS.items())
    ]
    derivative = Panel(
        "true $\\partial d / \\partial \\rho$ [px/mm]",
        "modelled $\\partial d / \\partial \\rho$ [px/mm]",
        [make_curve("exact", ends, ends, -1), *modelled],
        levels=[("", 0.0)],
    )
    errors = [marks([column(found, model, "whole") for model in MODELS])]
    error = Panel("", "$\\|\\hat{J} - J\\| / \\|J\\|$, scaled [1]", errors, categories=labels)
    figure = Figure("Effect of a constant λ on the Jacobian", [derivative, error], columns=2)
    yield ReportFigure("tool-model", range(settings.scenes), figure)
    trials = _trials(settings, results).values()
    numbers = {
        "settle_time": "settled after [s]",
        "pose": "pose error of marker 2 [mm]",
        "jacobian": "median error of $\\hat{J}$ [1]",
    }
    panels = mark_panels(
        numbers,
        lambda key: [column(some, key) for some in trials],
        labels,
        log=("pose", "jacobian"),
    )
    figure = Figure("Closed loops with either tool model", panels, columns=3)
    yield ReportFigure("tool-loops", range(settings.loops), figure)
