"""Check of rule (21): estimator time that it needs until Ĵ suffices for the controller.

Experiment `estimator-time`; the rule itself is in estimation/projection_rule.py. Estimator time is
the integration time of (21), independent of real time. The fits use fixed observations in random
scenes, without motion, with the printed Γ and with the fast Γ.
"""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation import projection_rule
from rcmservo.estimation.projection_rule import (
    GAMMA_0,
    build_normal_equations,
    compute_estimated_jacobian,
)
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.features import shift_to_rcm
from rcmservo.geometry.projection import project
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import integrate_gradient_flow
from rcmservo.paper.lab.cameras import PINHOLE, true_parameters
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import median
from rcmservo.sim import Rig, RigSettings

GAMMA_NAMES = {"printed": "printed Γ", "fast": "fast Γ"}
FIT = projection_rule.ProjectionEstimator()
"""Estimator with the rate η and the regularisation ε of the fast Γ."""
STEPS = 31
"""Number of estimator times at which a fit is evaluated."""
JUDGED_TIMES = {"leads": ("printed", (2.0, 100.0, 1e4)), "leads-fast": ("fast", (2.0,))}
"""Γ and estimator times (s) of each claim."""
EXPECTED_FRACTIONS = {2.0: 0.03, 100.0: 0.10, 1e4: 1.0}
"""Fractions of the scenes that the critical reading of the paper states for the printed Γ, by
estimator time (s)."""
MAX_SLOW_FRACTIONS = {2.0: 0.2, 100.0: 0.4}
"""Largest fractions that still confirm a slow solver, by estimator time (s)."""
ERROR, DEFINITE, POSITIVE = 0, 1, 2
"""Indices of the columns of `judge_jacobian`."""


def tasks(settings: Settings) -> list[Task]:
    """Return two tasks, each with every second scene."""
    work, scenes = partial(fit_scenes, settings=settings), range(settings.scenes)
    return [Task(f"fits-{i}", partial(work, seeds=scenes[i::2]), cost=5.0) for i in (0, 1)]


def list_times(settings: Settings) -> Floats:
    """Return the estimator times (STEPS,) in s."""
    first, last = settings.times
    return np.geomspace(float(first), float(last), STEPS)


def fit_scenes(settings: Settings, seeds: Sequence[int]) -> TaskResult:
    """Return the results of `judge_jacobian` (scenes, STEPS, 3), by Γ and noise."""
    rigs = [Rig(seed, RigSettings(scene=PINHOLE), pictures=False) for seed in seeds]
    return {
        f"{gamma} {noise:g}": np.array([fit_scene(rig, settings, noise, gamma) for rig in rigs])
        for gamma in GAMMA_NAMES
        for noise in settings.noises
    }


def fit_scene(rig: Rig, settings: Settings, noise: float, gamma: str) -> list[list[float]]:
    """Return the results of `judge_jacobian` over time in one scene, with Ĵ amid its data."""
    a, o_c = true_parameters(rig)
    q, tool = rig.scene.start, rig.settings.tool
    p1 = rig.body.points(q)[0]
    rows = draw_observations(a, p1, settings, noise, np.random.default_rng(rig.seed))
    fitted = projection_rule.collect_fitted_points(rows, len(rows), np.zeros(2), False, tool.struct)
    A, b = build_normal_equations(fitted)
    root = np.diag(np.sqrt(GAMMA_0))
    if gamma == "fast":
        root = np.sqrt(FIT.rate) * projection_rule.compute_inverse_root(A, FIT.epsilon)
    J, m = rig.truth.jacobian(q, o_c), shift_to_rcm(rig.truth.pixels(q), o_c)
    a_hats = [
        integrate_gradient_flow(A, b, np.zeros(len(b)), root, t) for t in list_times(settings)
    ]
    return [
        judge_jacobian(compute_estimated_jacobian(a_hat, p1, m, tool.struct), J) for a_hat in a_hats
    ]


def draw_observations(
    a: Floats, p1: Floats, settings: Settings, noise: float, random: np.random.Generator
) -> Floats:
    """Return P observations [p₁ in mm, m₁ in px, m₂ (unused)] (P, 7) within `reach` mm of `p1`."""
    rows = np.zeros((settings.observations, 7))
    for row in rows:
        offset = random.standard_normal(3)
        length = random.uniform() ** (1.0 / 3.0)
        row[:3] = p1 + settings.reach * length * offset / np.linalg.norm(offset)
        row[3:5] = project(a, row[:3]) + noise * random.standard_normal(2)
    return rows


def judge_jacobian(J_hat: Floats, J: Floats) -> list[float]:
    """Return the scaled error of Ĵ, and whether J Ĵ⁻¹ meets two conditions (1 or 0).

    The conditions on the scaled matrix are a positive definite symmetric part, and eigenvalues with
    positive real parts. A singular Ĵ meets neither.
    """
    J_hat, J = scale_rows(J_hat), scale_rows(J)
    error = float(np.linalg.norm(J_hat - J) / np.linalg.norm(J))
    if not (np.isfinite(J_hat).all() and np.linalg.cond(J_hat) < 1e12):
        return [error, 0.0, 0.0]
    J_by_J_hat = np.linalg.solve(J_hat.T, J.T).T
    is_definite = np.linalg.eigvalsh(J_by_J_hat + J_by_J_hat.T)[0] > 0.0
    is_positive = np.min(np.linalg.eigvals(J_by_J_hat).real) > 0.0
    return [error, float(is_definite), float(is_positive)]


def join_scenes(results: Results, gamma: str, noise: float) -> Floats:
    """Return the results of `judge_jacobian` (scenes, STEPS, 3) for one Γ and one noise."""
    halves = results.per_seed("fits", (0, 1))
    return np.concatenate([half[f"{gamma} {noise:g}"] for half in halves])


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    for claim, (gamma, judged_times) in JUDGED_TIMES.items():
        clean, noisy = (join_scenes(results, gamma, noise) for noise in settings.noises)
        for time in judged_times:
            step = int(np.argmin(np.abs(np.log(list_times(settings) / time))))
            at_time, noisy_at_time = clean[:, step], noisy[:, step]
            positive = float(np.mean(at_time[:, POSITIVE]))
            yield Measurement(
                claim,
                positive,
                range(settings.scenes),
                case=(f"after {time:g} s of estimator time",),
                trapped=time in MAX_SLOW_FRACTIONS,
                confirmed=positive <= MAX_SLOW_FRACTIONS.get(time, 1.0),
                critical=EXPECTED_FRACTIONS[time],
                positive=positive,
                definite=np.mean(at_time[:, DEFINITE]),
                error=median(at_time[:, ERROR]),
                noisy_positive=np.mean(noisy_at_time[:, POSITIVE]),
                noisy_definite=np.mean(noisy_at_time[:, DEFINITE]),
                noisy_error=median(noisy_at_time[:, ERROR]),
                longest=np.mean(clean[:, -1, POSITIVE]),
            )


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    labels = {
        ERROR: "median $\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
        POSITIVE: "eigenvalues\npositive, fraction [1]",
        DEFINITE: "symmetric part\npositive, fraction [1]",
    }
    panels = [draw_panel(settings, results, index, label) for index, label in labels.items()]
    yield PaperFigure("gammas", range(settings.scenes), Figure("Γ over estimator time", panels))


def draw_panel(settings: Settings, results: Results, index: int, label: str) -> Panel:
    """Return one column of `judge_jacobian` over time, for each Γ and noise."""
    is_error, curves = index == ERROR, list[Curve]()
    cases = [(gamma, noise) for gamma in GAMMA_NAMES for noise in settings.noises]
    for style, (gamma, noise) in enumerate(cases):
        values = join_scenes(results, gamma, noise)[:, :, index]
        summary = np.median(values, axis=0) if is_error else np.mean(values, axis=0)
        name = f"{GAMMA_NAMES[gamma]}, {noise:g} px" if index == POSITIVE else ""
        curves.append(make_curve(name, list_times(settings), summary, style))
    limits, x = (1e-4, 100.0) if is_error else (-0.05, 1.05), "estimator time [s]"
    return Panel(x, label, curves, log_x=True, log_y=is_error, y_limits=limits)
