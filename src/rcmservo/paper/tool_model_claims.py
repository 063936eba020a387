"""Check of II-B: the paper's constant λ, compared with a rigid shaft, which is the default.

Experiment `tool-model`; the models themselves are in geometry/tool.py. They are compared without
motion, with Ĵ from the true a, and in closed loops in which the servo uses either model.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.estimation.projection_rule import compute_estimated_jacobian
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.features import shift_to_rcm
from rcmservo.geometry.tool import RigidTool, ScaledTool, Tool
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.cameras import PINHOLE, true_parameters
from rcmservo.paper.lab.evaluation import count_settled, list_failures, settle
from rcmservo.paper.lab.paper_settings import POINT_NOISE_PX
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import (
    column,
    curve_per_label,
    finite,
    group_marks,
    mark_panels,
    median,
)
from rcmservo.sim import Rig, RigSettings
from rcmservo.study.report.statistics import format_finite

SPACING_MM = 30.0
"""Distance (mm) between the markers on the simulated tool."""
MODEL_NAMES = {"rigid": "rigid shaft", "constant": "constant λ"}
LABORATORY = RigSettings(tool=RigidTool(SPACING_MM), point_noise=POINT_NOISE_PX)


def tasks(settings: Settings) -> list[Task]:
    work = partial(run_loops, settings=settings)
    scenes = Task("scenes", partial(compare_scenes, settings=settings))
    return [scenes, *Task.per_seed("loop", work, range(settings.loops))]


def make_tools(p1: Floats) -> dict[str, Tool]:
    """Return both models of a tool; they agree for marker 1 at `p1` (3,) in mm."""
    constant = ScaledTool(1.0 + SPACING_MM / float(np.linalg.norm(p1)))
    return {"rigid": RigidTool(SPACING_MM), "constant": constant}


def compare_scenes(settings: Settings) -> TaskResult:
    """Return the results of `compare_scene` for each scene."""
    return {"scenes": [compare_scene(seed) for seed in range(settings.scenes)]}


def compare_scene(seed: int) -> TaskResult:
    """Return the true ∂d/∂ρ (px/mm), and the errors of Ĵ from the true a with either tool model.

    The constant λ is exact at the pose itself, so that both models predict the same m₂. ``along``
    is ∂d/∂ρ (px/mm), ``whole`` the scaled error of Ĵ, ``row`` the relative error of its d row.
    """
    rig = Rig(seed, RigSettings(scene=PINHOLE), pictures=False)
    a, o_c = true_parameters(rig)
    q = rig.scene.start
    p1: Floats = rig.body.points(q)[0]
    J, m = rig.truth.jacobian(q, o_c), shift_to_rcm(rig.truth.pixels(q), o_c)
    d_row: Floats = J[2]
    n = p1 / np.linalg.norm(p1)
    comparison: dict[str, object] = {"true": d_row @ n}
    for model, tool in make_tools(p1).items():
        J_hat = compute_estimated_jacobian(a, p1, m, tool.struct)
        comparison[model] = {
            "along": J_hat[2] @ n,
            "whole": rig.truth.jacobian_error(J_hat, q, o_c),
            "row": np.linalg.norm(J_hat[2] - d_row) / np.linalg.norm(d_row),
        }
    return comparison


def run_loops(settings: Settings, seed: int) -> TaskResult:
    """Return the trial of one seed with either tool model in the servo; λ is exact at the start."""
    rig = Rig(seed, LABORATORY, pictures=False)
    tools = make_tools(rig.body.points(rig.scene.start)[0])
    return {m: settle(seed, LABORATORY, settings.duration, tool)[0] for m, tool in tools.items()}


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    scenes, seeds = results["scenes"]["scenes"], range(settings.scenes)
    rigid, constant = (median(column(scenes, model, "whole")) for model in MODEL_NAMES)
    texts = Texts(row=median(column(scenes, "constant", "row")), rigid=rigid)
    yield Measurement("jacobian", constant, seeds, confirmed=constant > 0.1 >= rigid, **texts)
    opposite = column(scenes, "true") * column(scenes, "constant", "along") < 0.0
    wrong = float(np.mean(opposite))
    flags = Texts(remarked=wrong > 0.0, confirmed=wrong >= 0.25)
    yield Measurement("sign", 1.0 - wrong, seeds, **flags, wrong=wrong)
    trials = trials_by_model(settings, results)
    counts = {model: count_settled(trials[model]) for model in trials}
    errors = {model: median(finite(column(trials[model], "jacobian"))) for model in trials}
    yield Measurement(
        "settles",
        counts["constant"] / settings.loops,
        range(settings.loops),
        confirmed=errors["constant"] > 2.0 * errors["rigid"],
        errors={model: format_finite(error) for model, error in errors.items()},
        counts=counts,
        settled={model: summarise_settled(trials[model]) for model in trials},
        reasons=list_failures(trials["constant"]),
    )


def trials_by_model(settings: Settings, results: Results) -> dict[str, list[TaskResult]]:
    loops = results.per_seed("loop", range(settings.loops))
    return {model: [loop[model] for loop in loops] for model in MODEL_NAMES}


def summarise_settled(trials: list[TaskResult]) -> str:
    settled = [trial for trial in trials if not trial["failure"]]
    time, pose = (median(column(settled, name)) for name in ("settle_time", "pose"))
    times, poses = format_finite(time, ".1f"), format_finite(pose, ".2g")
    return f"median after {times} s, pose error {poses} mm"


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    scenes, names = results["scenes"]["scenes"], list(MODEL_NAMES.values())
    true = column(scenes, "true")
    ends = [true.min(), true.max()]

    def modelled_over_true(model: str) -> tuple[Floats, Floats]:
        return true, column(scenes, model, "along")

    modelled = curve_per_label(MODEL_NAMES, modelled_over_true, marks=True)
    derivative = Panel(
        "true $\\partial d / \\partial \\rho$ [px/mm]",
        "modelled $\\partial d / \\partial \\rho$ [px/mm]",
        [make_curve("exact", ends, ends, -1), *modelled],
        levels=[("", 0.0)],
    )
    errors = [group_marks([column(scenes, model, "whole") for model in MODEL_NAMES])]
    error = Panel("", "$\\|\\hat{J} - J\\| / \\|J\\|$, scaled [1]", errors, categories=names)
    figure = Figure("Effect of a constant λ on the Jacobian", [derivative, error], columns=2)
    yield PaperFigure("tool-model", range(settings.scenes), figure)
    trials = trials_by_model(settings, results).values()
    labels = {
        "settle_time": "settled after [s]",
        "pose": "pose error of marker 2 [mm]",
        "jacobian": "median error of $\\hat{J}$ [1]",
    }

    def list_values(name: str) -> list[Floats]:
        return [column(model_trials, name) for model_trials in trials]

    panels = mark_panels(labels, list_values, names, log=("pose", "jacobian"))
    figure = Figure("Closed loops with either tool model", panels, columns=3)
    yield PaperFigure("tool-loops", range(settings.loops), figure)
