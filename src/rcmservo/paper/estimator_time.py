"""Experiment `estimator-time`: estimator time that rule (21) needs until Ĵ suffices for the law.

Estimator time is the integration time of (21), independent of real time. The fits use fixed
observations in random scenes, without motion, with the printed Γ and with the fast Γ.
"""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.projection_rule import (
    GAMMA_0,
    ProjectionEstimator,
    feature_jacobian,
    fitted_points,
    inverse_root,
    normal_equations,
)
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.features import shift_to_rcm
from rcmservo.geometry.projection import project
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import integrate_gradient_flow
from rcmservo.paper.lab.cameras import PINHOLE, true_parameters
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import median
from rcmservo.sim import Rig, RigSettings

GAMMAS = {"printed": "printed Γ", "fast": "fast Γ"}
FIT = ProjectionEstimator()
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
"""Indices of the columns of `leads`."""


def tasks(settings: Settings) -> list[Task]:
    scenes = range(settings.scenes)
    return [
        Task(f"fits-{i}", partial(fits, settings=settings, seeds=scenes[i::2]), cost=5.0)
        for i in (0, 1)
    ]


def times(settings: Settings) -> Floats:
    """Return the estimator times (STEPS,) in s."""
    first, last = settings.times
    return np.geomspace(float(first), float(last), STEPS)


def fits(settings: Settings, seeds: Sequence[int]) -> TaskResult:
    """Return the results of `leads` (scenes, STEPS, 3), by Γ and noise."""
    rigs = [Rig(seed, RigSettings(scene=PINHOLE), pictures=False) for seed in seeds]
    return {
        f"{name} {noise:g}": np.array([one_scene(rig, settings, noise, name) for rig in rigs])
        for name in GAMMAS
        for noise in settings.noises
    }


def one_scene(rig: Rig, settings: Settings, noise: float, name: str) -> list[list[float]]:
    """Return the results of `leads` over time in one scene, for Ĵ amid the observations."""
    a, o_c = true_parameters(rig)
    q, tool = rig.scene.start, rig.settings.tool
    p1 = rig.body.points(q)[0]
    rows = observed(a, p1, settings, noise, np.random.default_rng(rig.seed))
    A, b = normal_equations(fitted_points(rows, len(rows), np.zeros(2), False, tool.struct))
    fast = np.sqrt(FIT.rate) * inverse_root(A, FIT.epsilon)
    root = np.diag(np.sqrt(GAMMA_0)) if name == "printed" else fast
    J, m = rig.truth.jacobian(q, o_c), shift_to_rcm(rig.truth.pixels(q), o_c)

    def judged(t: float) -> list[float]:
        a_hat = integrate_gradient_flow(A, b, np.zeros(len(b)), root, t)
        return leads(feature_jacobian(a_hat, p1, m, tool.struct), J)

    return [judged(t) for t in times(settings)]


def observed(
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


def leads(J_hat: Floats, J: Floats) -> list[float]:
    """Return the scaled error of Ĵ, and whether J Ĵ⁻¹ meets two conditions (1 or 0).

    The conditions on the scaled matrix are a positive definite symmetric part, and eigenvalues with
    positive real parts. A singular Ĵ meets neither.
    """
    J_hat, J = scale_rows(J_hat), scale_rows(J)
    error = float(np.linalg.norm(J_hat - J) / np.linalg.norm(J))
    if not (np.isfinite(J_hat).all() and np.linalg.cond(J_hat) < 1e12):
        return [error, 0.0, 0.0]
    product = np.linalg.solve(J_hat.T, J.T).T
    definite = np.linalg.eigvalsh(product + product.T)[0] > 0.0
    return [error, float(definite), float(np.min(np.linalg.eigvals(product).real) > 0.0)]


def all_scenes(results: Results, name: str, noise: float) -> Floats:
    """Return the results of `leads` (scenes, STEPS, 3) for one Γ and one noise."""
    halves = results.per_seed("fits", (0, 1))
    return np.concatenate([half[f"{name} {noise:g}"] for half in halves])


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    for claim, (name, judged_times) in JUDGED_TIMES.items():
        clean, noisy = (all_scenes(results, name, noise) for noise in settings.noises)
        for time in judged_times:
            near = int(np.argmin(np.abs(np.log(times(settings) / time))))
            at, noisy_at = clean[:, near], noisy[:, near]
            positive = float(np.mean(at[:, POSITIVE]))
            yield Measurement(
                claim,
                positive,
                range(settings.scenes),
                case=(f"after {time:g} s of estimator time",),
                trapped=time in MAX_SLOW_FRACTIONS,
                confirmed=positive <= MAX_SLOW_FRACTIONS.get(time, 1.0),
                critical=EXPECTED_FRACTIONS[time],
                positive=positive,
                definite=np.mean(at[:, DEFINITE]),
                error=median(at[:, ERROR]),
                noisy_positive=np.mean(noisy_at[:, POSITIVE]),
                noisy_definite=np.mean(noisy_at[:, DEFINITE]),
                noisy_error=median(noisy_at[:, ERROR]),
                longest=np.mean(clean[:, -1, POSITIVE]),
            )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    labels = {
        ERROR: "median $\\|\\hat{J} - J\\| / \\|J\\|$ [1]",
        POSITIVE: "eigenvalues\npositive, fraction [1]",
        DEFINITE: "symmetric part\npositive, fraction [1]",
    }
    panels = [_panel(settings, results, index, label) for index, label in labels.items()]
    yield ReportFigure("gammas", range(settings.scenes), Figure("Γ over estimator time", panels))


def _panel(settings: Settings, results: Results, index: int, label: str) -> Panel:
    is_error = index == ERROR
    middle = np.median if is_error else np.mean
    cases = [(name, noise) for name in GAMMAS for noise in settings.noises]
    curves = [
        make_curve(
            f"{GAMMAS[name]}, {noise:g} px" if index == POSITIVE else "",
            times(settings),
            middle(all_scenes(results, name, noise)[:, :, index], axis=0),
            style,
        )
        for style, (name, noise) in enumerate(cases)
    ]
    limits = (1e-4, 100.0) if is_error else (-0.05, 1.05)
    return Panel("estimator time [s]", label, curves, log_x=True, log_y=is_error, y_limits=limits)
