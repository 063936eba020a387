"""Proposition 1, as a measurement: U never rises along rule (21), and how long it takes until Ĵ is
J.

Tried on noiseless observations before pinhole cameras, with the printed Γ and with our fast one.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.cameras import drawn, seen_by
from rcmservo.experiments.harness.claims import (
    Chapter,
    Claim,
    Experiment,
    Results,
    Shown,
    Task,
    median,
)
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.controller import scaled
from rcmservo.method.estimators.projection import (
    GAMMA_0,
    MAX_DECAY,
    ProjectionEstimator,
    decay,
    feature_jacobian,
    inverse_root,
    normal_equations,
    predict,
)
from rcmservo.method.projection import PARAMETERS, parameters, project
from rcmservo.sim import RigSettings

TOOL = RigSettings().tool
FIT = ProjectionEstimator()
"""Where the fast Γ's η and ε come from."""

GAMMAS = {"printed": "printed Γ", "fast": "our fast Γ"}
NEAR = 0.1
"""Scaled ‖Ĵ − J‖/‖J‖ up to which a fitted Ĵ counts as near J."""

LONG_ENOUGH = 30.0
"""Time in units of the slowest mode's after which rule (21) is taken to have come to its end."""


@dataclass(frozen=True)
class Settings:
    """``cameras`` are seeds, ``spread`` mm that of the P = ``observations`` points before each; the
    claims are about ``printed_time`` and ``fast_time`` s of estimator time, and ``longest`` s is
    the most shown."""

    cameras: tuple[int, ...] = tuple(range(20))
    spread: float = 20.0
    observations: int = 10
    printed_time: float = 1e4
    fast_time: float = 10.0
    longest: float = 1e5


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", all_cameras, {"settings": settings}, cost=3.0)]


def all_cameras(folder: Path, settings: Settings) -> dict[str, Any]:
    """What `one_camera` finds of every camera."""
    del folder
    return {str(seed): one_camera(settings, seed) for seed in settings.cameras}


def one_camera(settings: Settings, seed: int) -> dict[str, Any]:
    """What rule (21) does with either Γ, on the same observations."""
    C, p0 = drawn(seed)
    a, o_c = parameters(C)
    random = np.random.default_rng([seed, 2])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.observations, 3))
    rows = np.array([[*p, *seen_by(C, p), np.nan, np.nan] for p in points])
    A, b = normal_equations(rows, len(rows), o_c, False, TOOL.shaft)
    printed, fast = np.diag(np.sqrt(GAMMA_0)), np.sqrt(FIT.rate) * inverse_root(A, FIT.epsilon)
    found = {
        "printed": fall_of_U(A, b, a, printed, settings.longest, settings.printed_time),
        "fast": fall_of_U(A, b, a, fast, MAX_DECAY / FIT.rate, settings.fast_time),
    }
    return {name: judged(fall, a, p0, points) for name, fall in found.items()}


@dataclass(frozen=True)
class Fall:
    """U (n,) of (22) at ``time`` (n,) s along rule (21), â ``late`` and at its ``end``, the
    ``slowest`` rate 1/s."""

    time: Floats
    U: Floats
    late: Floats
    end: Floats
    slowest: float


def fall_of_U(A: Floats, b: Floats, a: Floats, root: Floats, longest: float, late: float) -> Fall:
    """Rule (21) with Γ = root rootᵀ from â = 0, up to `longest` s, at `late` s and at its end."""
    slowest = float(np.linalg.eigvalsh(root.T @ A @ root)[0])
    time = np.concatenate([[0.0], np.geomspace(1e-4, longest, 200)])
    moments = [*time, late, LONG_ENOUGH / slowest]
    *a_hats, a_late, a_end = [decay(A, b, np.zeros(PARAMETERS), root, t) for t in moments]
    U = np.array([0.5 * float(np.sum(np.linalg.solve(root, a_hat - a) ** 2)) for a_hat in a_hats])
    return Fall(time, U, a_late, a_end, slowest)


def judged(fall: Fall, a: Floats, p0: Floats, points: Floats) -> dict[str, Any]:
    """U/U(0) and its largest rise, the errors of Ĵ at p0 and of the projection of the `points`
    px."""
    ratio = fall.U / fall.U[0]
    return {
        "time": fall.time.tolist(),
        "U": ratio.tolist(),
        "rise": float(max(np.max(np.diff(fall.U)) / fall.U[0], 0.0)),
        "reprojection": max(
            float(np.linalg.norm(project(fall.late, p) - project(a, p))) for p in points
        ),
        "jacobian": jacobian_error(fall.late, a, p0),
        "end": jacobian_error(fall.end, a, p0),
        "slowest": fall.slowest,
    }


def jacobian_error(a_hat: Floats, a: Floats, p1: Floats) -> float:
    """‖Ĵ − J‖/‖J‖ (Frobenius) of the scaled Jacobians at p1, from â and from the true a."""
    m = predict(a, p1, TOOL.shaft)
    J_hat, J = (scaled(feature_jacobian(some, p1, m, TOOL.shaft)) for some in (a_hat, a))
    return float(np.linalg.norm(J_hat - J) / np.linalg.norm(J))


def chapter(settings: Settings, results: Results) -> Chapter:
    values = results["cameras"].values
    return Chapter(_claims(settings, values), [_figure(settings, values)])


def _claims(settings: Settings, values: dict[str, Any]) -> list[Claim]:
    seeds = settings.cameras
    printed, fast = ([one[name] for one in values.values()] for name in GAMMAS)
    late = [one["jacobian"] for one in printed]
    slowest = [1.0 / one["slowest"] for one in printed]
    bad = sum(error > NEAR for error in late)
    about = (
        f"P = {settings.observations} noiseless observations of marker 1 within "
        f"±{settings.spread:g} mm before each of "
        f"{len(seeds)} cameras"
    )
    return [
        Claim(
            "U of (22) never rises along rule (21), with the printed Γ",
            "Proposition 1, (23)",
            max(one["rise"] for one in printed),
            "of U(0)",
            "<=",
            1e-9,
            seeds,
            detail=f"largest rise between 200 moments up to {settings.longest:g} s; {about}",
            figure="U",
        ),
        Claim(
            "U never rises with our fast Γ either",
            "ours",
            max(one["rise"] for one in fast),
            "of U(0)",
            "<=",
            1e-9,
            seeds,
            figure="U",
        ),
        Claim(
            "rule (21) asymptotically estimates a, so that Ĵ tends to J, with the printed Γ",
            "Proposition 1",
            max(one["end"] for one in printed),
            "‖Ĵ − J‖/‖J‖",
            "<=",
            1e-6,
            seeds,
            remark=f"very slowly: the slowest mode's time constant is "
            f"{median(slowest) / 3600.0:.1f} h in the "
            f"median camera and {max(slowest) / 3600.0:.0f} h in the worst; judged after "
            f"{LONG_ENOUGH:g} of them",
            figure="U",
            trap="T6",
            confirmed=median(slowest) > 600.0,
        ),
        Claim(
            f"{settings.printed_time:g} s of estimator time, which we give the printed Γ for "
            f"every frame, bring Ĵ "
            f"within {100.0 * NEAR:g} % of J",
            "ours",
            max(late),
            "‖Ĵ − J‖/‖J‖",
            "<=",
            NEAR,
            seeds,
            remark=f"worse in {bad} of {len(late)} cameras" if bad else "",
            detail=f"{median(late):.3f} in the median, where the projection of the observations "
            f"is off by "
            f"{median([one['reprojection'] for one in printed]):.1f} px at most",
            figure="U",
            trap="T6",
            confirmed=max(late) > 10.0 * max(one["jacobian"] for one in fast),
        ),
        Claim(
            f"with our fast Γ {settings.fast_time:g} s bring Ĵ within {100.0 * NEAR:g} % of J",
            "ours",
            max(one["jacobian"] for one in fast),
            "‖Ĵ − J‖/‖J‖",
            "<=",
            NEAR,
            seeds,
            figure="U",
        ),
    ]


def _figure(settings: Settings, values: dict[str, Any]) -> Shown:
    shown = settings.cameras[:5]
    curves = [
        curve(
            label if seed == shown[0] else "",
            values[str(seed)][name]["time"][1:],
            np.maximum(values[str(seed)][name]["U"][1:], 1e-12),
            style,
        )
        for style, (name, label) in enumerate(GAMMAS.items())
        for seed in shown
    ]
    panel = Panel(
        "estimator time [s]", "U(t) / U(0)", curves, log_x=True, log_y=True, y_limits=(1e-9, 3.0)
    )
    caption = (
        f"U of (22) along rule (21) from â = 0, P = {settings.observations} noiseless "
        f"observations of marker 1 before "
        f"{len(shown)} cameras. Each U is measured by its own Γ, so that only the falls compare."
    )
    return Shown(
        "U", "Proposition 1, (22)-(23)", caption, list(shown), Figure("Proposition 1", [panel])
    )


EXPERIMENT = Experiment(
    name="proposition-1",
    title="Proposition 1: rule (21) converges",
    about="U of (22) along rule (21), and the time until Ĵ is J, with the printed Γ and with ours.",
    whole=Settings(),
    quick=Settings(cameras=(0, 1, 2)),
    tasks=tasks,
    chapter=chapter,
)
