"""Proposition 1, as a measurement: U never rises along rule (21), and how long it takes until Ĵ is
J.

Tried on noiseless observations before pinhole cameras, with the printed Γ and with our fast one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.cameras import drawn, seen_by
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.controller import scaled
from rcmservo.method.estimators.decay import decay
from rcmservo.method.estimators.projection import (
    GAMMA_0,
    MAX_DECAY,
    ProjectionEstimator,
    feature_jacobian,
    inverse_root,
    normal_equations,
    predict,
    sights,
)
from rcmservo.method.projection import PARAMETERS, parameters, project
from rcmservo.sim import RigSettings

TOOL = RigSettings().tool
FIT = ProjectionEstimator()
"""Where the fast Γ's η and ε come from."""

NEAR = 0.1
"""Scaled ‖Ĵ − J‖/‖J‖ up to which a fitted Ĵ counts as near J."""

LONG_ENOUGH = 30.0
"""Time in units of the slowest mode's after which rule (21) is taken to have come to its end."""


@dataclass(frozen=True)
class Settings:
    """Noiseless observations before several cameras, and how long rule (21) has."""

    cameras: tuple[int, ...] = tuple(range(20))
    """Seeds."""
    spread: float = 20.0
    """mm about the tool's start within which the observed points lie."""
    observations: int = 10
    """P."""
    printed_time: float = 1e4
    """s of estimator time after which the printed Γ is judged."""
    fast_time: float = 10.0
    """The same of our fast Γ."""
    longest: float = 1e5
    """s of estimator time that are shown."""


@dataclass(frozen=True)
class FallOfU:
    """What rule (21) did with one Γ before one camera."""

    time: JsonFloats
    """s."""
    U: JsonFloats
    """Over U(0)."""
    rise: float
    """Largest between two moments, of U(0)."""
    reprojection: float
    """Largest distance px of the observations after the time judged."""
    jacobian: float
    """Scaled error of Ĵ then."""
    end: float
    """Scaled error of Ĵ after LONG_ENOUGH."""
    slowest: float
    """Rate 1/s of the slowest mode."""


@dataclass(frozen=True)
class BothGammas:
    """Both Γ before every camera."""

    printed: list[FallOfU]
    """The printed Γ, of every camera in the order of the seeds."""
    fast: list[FallOfU]
    """Our fast Γ, of every camera in the order of the seeds."""


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", partial(all_cameras, settings=settings), cost=3.0)]


def all_cameras(folder: Path, settings: Settings) -> BothGammas:
    """What `one_camera` finds of every camera."""
    del folder
    printed, fast = zip(*(one_camera(settings, seed) for seed in settings.cameras), strict=True)
    return BothGammas(list(printed), list(fast))


def one_camera(settings: Settings, seed: int) -> tuple[FallOfU, FallOfU]:
    """What rule (21) does with the printed and with our fast Γ, on the same observations."""
    C, p0 = drawn(seed)
    a, o_c = parameters(C)
    random = np.random.default_rng([seed, 2])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.observations, 3))
    rows = np.array([[*p, *seen_by(C, p), np.nan, np.nan] for p in points])
    A, b = normal_equations(sights(rows, len(rows), o_c, False, TOOL.shaft))
    printed, fast = np.diag(np.sqrt(GAMMA_0)), np.sqrt(FIT.rate) * inverse_root(A, FIT.epsilon)
    slow = fall_of_U(A, b, a, printed, settings.longest, settings.printed_time)
    soon = fall_of_U(A, b, a, fast, MAX_DECAY / FIT.rate, settings.fast_time)
    return judged(slow, a, p0, points), judged(soon, a, p0, points)


@dataclass(frozen=True)
class Fall:
    """Rule (21) over its own time."""

    time: Floats
    """s (n,)."""
    U: Floats
    """Of (22), (n,)."""
    late: Floats
    """â (9,) at the time that is judged."""
    end: Floats
    """â (9,) at its end."""
    slowest: float
    """Rate 1/s of the slowest mode."""


def fall_of_U(A: Floats, b: Floats, a: Floats, root: Floats, longest: float, late: float) -> Fall:
    """Rule (21) with Γ = root rootᵀ from â = 0, up to `longest` s, at `late` s and at its end."""
    slowest = float(np.linalg.eigvalsh(root.T @ A @ root)[0])
    time = np.concatenate([[0.0], np.geomspace(1e-4, longest, 200)])
    moments = [*time, late, LONG_ENOUGH / slowest]
    *a_hats, a_late, a_end = [decay(A, b, np.zeros(PARAMETERS), root, t) for t in moments]
    U = np.array([0.5 * float(np.sum(np.linalg.solve(root, a_hat - a) ** 2)) for a_hat in a_hats])
    return Fall(time, U, a_late, a_end, slowest)


def judged(fall: Fall, a: Floats, p0: Floats, points: Floats) -> FallOfU:
    """The errors of Ĵ at p0 and of the projection of the `points`, and how U fell."""
    away = [np.linalg.norm(project(fall.late, p) - project(a, p)) for p in points]
    return FallOfU(
        time=fall.time,
        U=fall.U / fall.U[0],
        rise=float(max(np.max(np.diff(fall.U)) / fall.U[0], 0.0)),
        reprojection=float(np.max(away)),
        jacobian=jacobian_error(fall.late, a, p0),
        end=jacobian_error(fall.end, a, p0),
        slowest=fall.slowest,
    )


def jacobian_error(a_hat: Floats, a: Floats, p1: Floats) -> float:
    """‖Ĵ − J‖/‖J‖ (Frobenius) of the scaled Jacobians at p1, from â and from the true a."""
    m = predict(a, p1, TOOL.shaft)
    J_hat, J = (scaled(feature_jacobian(some, p1, m, TOOL.shaft)) for some in (a_hat, a))
    return float(np.linalg.norm(J_hat - J) / np.linalg.norm(J))


def chapter(settings: Settings, results: Results) -> Chapter:
    found = results.of(BothGammas, "cameras")
    claims = [
        printed_never_rises(settings, found),
        tends_to_a(settings, found),
        fast_never_rises(settings, found),
        printed_in_time(settings, found),
        fast_in_time(settings, found),
    ]
    return Chapter(claims, [_figure(settings, found)])


def printed_never_rises(settings: Settings, found: BothGammas) -> Claim:
    return Claim(
        "U of (22) never rises along rule (21) with the printed Γ: largest rise",
        "stable-21",
        max(one.rise for one in found.printed),
        "of U(0)",
        "<=",
        1e-9,
        settings.cameras,
        detail=f"between 200 moments up to {settings.longest:g} s; P = {settings.observations} "
        f"noiseless observations of marker 1 within ±{settings.spread:g} mm before each camera",
        figure="U",
    )


def fast_never_rises(settings: Settings, found: BothGammas) -> Claim:
    return Claim(
        "U never rises with our fast Γ either: largest rise",
        OURS,
        max(one.rise for one in found.fast),
        "of U(0)",
        "<=",
        1e-9,
        settings.cameras,
        figure="U",
    )


def tends_to_a(settings: Settings, found: BothGammas) -> Claim:
    slowest = [1.0 / one.slowest for one in found.printed]
    return Claim(
        "with the printed Γ and without noise Ĵ tends to J: largest ‖Ĵ − J‖/‖J‖",
        "estimates-a",
        max(one.end for one in found.printed),
        "of ‖J‖",
        "<=",
        1e-6,
        settings.cameras,
        remark="very slowly: the slowest mode's time constant is "
        f"{median(slowest) / 3600.0:.1f} h in the median camera and "
        f"{max(slowest) / 3600.0:.0f} h in the worst; judged after {LONG_ENOUGH:g} of them",
        figure="U",
        trap="T6",
        confirmed=median(slowest) > 600.0,
    )


def printed_in_time(settings: Settings, found: BothGammas) -> Claim:
    late = [one.jacobian for one in found.printed]
    bad = sum(error > NEAR for error in late)
    off = median([one.reprojection for one in found.printed])
    return Claim(
        f"{settings.printed_time:g} s of estimator time, which we give the printed Γ for every "
        f"frame, bring Ĵ within {100.0 * NEAR:g} % of J in every camera",
        OURS,
        max(late),
        "of ‖J‖",
        "<=",
        NEAR,
        settings.cameras,
        remark=f"worse in {bad} of {len(late)} cameras" if bad else "",
        detail=f"{median(late):.3f} in the median, where the projection of the observations is "
        f"off by {off:.1f} px at most",
        figure="U",
        trap="T6",
        confirmed=max(late) > 10.0 * max(one.jacobian for one in found.fast),
    )


def fast_in_time(settings: Settings, found: BothGammas) -> Claim:
    return Claim(
        f"with our fast Γ {settings.fast_time:g} s bring Ĵ within {100.0 * NEAR:g} % of J in "
        "every camera",
        OURS,
        max(one.jacobian for one in found.fast),
        "of ‖J‖",
        "<=",
        NEAR,
        settings.cameras,
        figure="U",
    )


SHOWN = 5
"""Cameras in the figure."""


def _figure(settings: Settings, found: BothGammas) -> Shown:
    falls: dict[str, Sequence[FallOfU]] = {
        "printed Γ": found.printed[:SHOWN],
        "our fast Γ": found.fast[:SHOWN],
    }
    curves = [
        curve(label if i == 0 else "", one.time[1:], np.maximum(one.U[1:], 1e-12), style)
        for style, (label, some) in enumerate(falls.items())
        for i, one in enumerate(some)
    ]
    panel = Panel(
        "estimator time [s]", "U(t) / U(0)", curves, log_x=True, log_y=True, y_limits=(1e-9, 3.0)
    )
    shown = settings.cameras[:SHOWN]
    caption = (
        f"U of (22) along rule (21) from â = 0, P = {settings.observations} noiseless "
        f"observations of marker 1 before {len(shown)} cameras. Each U is measured by its own Γ, "
        "so that only the falls compare."
    )
    figure = Figure("Proposition 1", [panel])
    return Shown("U", "Proposition 1, (22)-(23)", caption, list(shown), figure)


EXPERIMENT = Experiment(
    name="proposition-1",
    title="Proposition 1: rule (21) converges",
    about="U of (22) along rule (21), and the time until Ĵ is J, with the printed Γ and with ours.",
    whole=Settings(),
    quick=Settings(cameras=(0, 1, 2)),
    tasks=tasks,
    chapter=chapter,
)
