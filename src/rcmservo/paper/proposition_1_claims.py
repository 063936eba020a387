"""Check of Proposition 1: U decreases monotonically along rule (21), and Ĵ converges to J.

Experiment `proposition-1`; the rule itself is in estimation/projection_rule.py. Observations are
without noise, from pinhole cameras, with the printed Γ and with the fast Γ.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation import projection_rule
from rcmservo.estimation.projection_rule import (
    GAMMA_0,
    build_normal_equations,
    compute_estimated_jacobian,
)
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.projection import PARAMETER_COUNT, extract_parameters, project
from rcmservo.interfaces import Floats
from rcmservo.numerics.gradient_flow import integrate_gradient_flow
from rcmservo.paper.lab.cameras import project_point, random_camera
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, median
from rcmservo.sim import RigSettings

TOOL = RigSettings().tool
FIT = projection_rule.ProjectionEstimator()
"""Estimator with the rate η and the regularisation ε of the fast Γ."""
SHOWN_CAMERAS = 5
"""Number of cameras in the figure."""
MIN_SLOW_TIME_H = 600.0 / 3600.0
"""Time constant (h) of the slowest mode above which the printed Γ is a slow solver."""
GAMMA_NAMES = {"printed": "printed Γ", "fast": "fast Γ"}


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", partial(observe_cameras, settings=settings), cost=3.0)]


def observe_cameras(settings: Settings) -> TaskResult:
    """Return the results of `observe_camera` for each camera, by Γ."""
    cameras = [observe_camera(settings, seed) for seed in range(settings.cameras)]
    return {name: [camera[name] for camera in cameras] for name in GAMMA_NAMES}


def observe_camera(settings: Settings, seed: int) -> dict[str, TaskResult]:
    """Return U over time with the printed and the fast Γ, on the same observations."""
    C, p0 = random_camera(seed)
    a, o_c = extract_parameters(C)
    random = np.random.default_rng([seed, 2])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.observations, 3))
    rows = np.array([[*p, *project_point(C, p), np.nan, np.nan] for p in points])
    fitted = projection_rule.collect_fitted_points(rows, len(rows), o_c, False, TOOL.struct)
    A, b = build_normal_equations(fitted)

    def integrate_rule(root: Floats, longest: float, judged_at: float) -> TaskResult:
        """Return the solution of rule (21) with Γ = root rootᵀ from â = 0."""
        slowest = float(np.linalg.eigvalsh(root.T @ A @ root)[0])
        time = np.concatenate([[0.0], np.geomspace(1e-4, longest, 200)])
        moments = [*time, judged_at, settings.end / slowest]
        *a_hats, late, end = [
            integrate_gradient_flow(A, b, np.zeros(PARAMETER_COUNT), root, t) for t in moments
        ]
        U = np.array([0.5 * np.sum(np.linalg.solve(root, a_hat - a) ** 2) for a_hat in a_hats])
        errors = [np.linalg.norm(project(late, p) - project(a, p)) for p in points]
        return {
            "time": time,
            "U": U / U[0],
            "rise": max(np.max(np.diff(U)) / U[0], 0.0),
            "reprojection": np.max(errors),
            "jacobian": compute_jacobian_error(late, a, p0),
            "end": compute_jacobian_error(end, a, p0),
            "slowest": slowest,
        }

    printed, fast = np.diag(np.sqrt(GAMMA_0)), projection_rule.compute_inverse_root(A, FIT.epsilon)
    fast, fast_longest = np.sqrt(FIT.rate) * fast, projection_rule.MAX_DECAY / FIT.rate
    return {
        "printed": integrate_rule(printed, settings.longest, settings.printed_time),
        "fast": integrate_rule(fast, fast_longest, settings.fast_time),
    }


def compute_jacobian_error(a_hat: Floats, a: Floats, p1: Floats) -> float:
    """Return ‖Ĵ − J‖/‖J‖ (Frobenius) of the scaled Jacobians at `p1`, from â and the true a."""
    m = projection_rule.predict_markers(a, p1, TOOL.struct)
    J_hat, J = (
        scale_rows(compute_estimated_jacobian(some, p1, m, TOOL.struct)) for some in (a_hat, a)
    )
    return float(np.linalg.norm(J_hat - J) / np.linalg.norm(J))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    printed, fast = results["cameras"]["printed"], results["cameras"]["fast"]
    seeds, hours = range(settings.cameras), 1.0 / column(printed, "slowest") / 3600.0
    late, fast_late = column(printed, "jacobian"), column(fast, "jacobian")
    yield Measurement("printed-falls", column(printed, "rise").max(), seeds)
    is_slow = median(hours) > MIN_SLOW_TIME_H
    times = Texts(hours=median(hours), worst=hours.max())
    yield Measurement("tends-to-a", column(printed, "end").max(), seeds, confirmed=is_slow, **times)
    yield Measurement("fast-falls", column(fast, "rise").max(), seeds)
    near, percent = settings.near, 100.0 * settings.near
    inaccurate = int(np.count_nonzero(late > near))
    yield Measurement(
        "printed-in-time",
        late.max(),
        seeds,
        bound=near,
        remarked=bool(inaccurate),
        confirmed=late.max() > 10.0 * fast_late.max(),
        bad=inaccurate,
        percent=percent,
        middle=median(late),
        pixels=median(column(printed, "reprojection")),
    )
    yield Measurement("fast-in-time", fast_late.max(), seeds, bound=near, percent=percent)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    curves = [
        make_curve(label * (i == 0), camera["time"][1:], np.maximum(camera["U"][1:], 1e-12), style)
        for style, (name, label) in enumerate(GAMMA_NAMES.items())
        for i, camera in enumerate(results["cameras"][name][:SHOWN_CAMERAS])
    ]
    limits, shown = (1e-9, 3.0), range(min(settings.cameras, SHOWN_CAMERAS))
    x, y = "estimator time [s]", "U(t) / U(0)"
    panel = Panel(x, y, curves, log_x=True, log_y=True, y_limits=limits)
    yield PaperFigure("U", shown, Figure("Proposition 1", [panel]), texts={"shown": len(shown)})
