"""Experiment `lemma-1`: nine parameters of a camera, and the observations that determine them.

The cameras are pinholes without noise. The points are in general position, in a plane, and in a
plane that contains the RCM.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.projection import (
    PARAMETER_COUNT,
    build_regressor,
    extract_parameters,
    project,
)
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.cameras import project_point, random_camera
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult

RANK_TOLERANCE = 1e-9
"""Singular value, relative to the largest one, that counts as zero; M has columns of length 1."""

SETS = {
    "generic": "generic points",
    "coplanar": "points of a plane",
    "through": "points of a plane through the RCM",
}


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", partial(all_cameras, settings=settings))]


def all_cameras(settings: Settings) -> TaskResult:
    """Return the results of `one_camera` for each camera."""
    return {"cameras": [one_camera(settings, seed) for seed in range(settings.cameras)]}


def one_camera(settings: Settings, seed: int) -> TaskResult:
    """Return the reprojection error (px) of a and o_c, and singular values of M (24)."""
    C, p0 = random_camera(seed)
    a, o_c = extract_parameters(C)
    sets = point_sets(settings, seed, p0)
    errors = [np.linalg.norm(project(a, p) + o_c - project_point(C, p)) for p in sets["generic"]]
    return {
        "reprojection": np.max(errors),
        "five": singular_values(C, o_c, sets["generic"][:5]),
        "six": {name: singular_values(C, o_c, points[:6]) for name, points in sets.items()},
        "all": {name: singular_values(C, o_c, points) for name, points in sets.items()},
    }


def point_sets(settings: Settings, seed: int, p0: Floats) -> dict[str, Floats]:
    """Return points (n, 3) in mm about `p0`: random, in a plane, and in a plane through the RCM."""
    random = np.random.default_rng([seed, 1])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.points, 3))
    normal = random.standard_normal(3)
    normal /= np.linalg.norm(normal)
    across = normal - p0 * (normal @ p0) / (p0 @ p0)
    across /= np.linalg.norm(across)
    return {
        "generic": points,
        "coplanar": points - np.outer((points - p0) @ normal, normal),
        "through": points - np.outer(points @ across, across),
    }


def singular_values(C: Floats, o_c: Floats, points: Floats) -> Floats:
    """Return the singular values of M (24) over the largest one, for columns scaled to length 1."""
    M = np.concatenate([build_regressor(project_point(C, p) - o_c, p) for p in points])
    sigma = np.linalg.svd(M / np.linalg.norm(M, axis=0), compute_uv=False)
    return sigma / sigma[0]


def rank(sigma: Floats) -> int:
    return int(np.sum(sigma > RANK_TOLERANCE))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    found, seeds = results["cameras"]["cameras"], range(settings.cameras)
    yield Measurement("nine-enough", max(one["reprojection"] for one in found), seeds)
    five = [rank(one["five"]) for one in found]
    six, every = (
        {name: [rank(one[size][name]) for one in found] for name in SETS} for size in ("six", "all")
    )
    yield Measurement("nine-independent", min(six["generic"]), seeds)
    yield Measurement(
        "six-needed", max(five), seeds, confirmed=min(five) == PARAMETER_COUNT, five=min(five)
    )
    yield Measurement(
        "six-enough",
        min(six["coplanar"]),
        seeds,
        confirmed=max(six["coplanar"]) < PARAMETER_COUNT,
        six={name: max(ranks) for name, ranks in six.items()},
        every={name: max(ranks) for name, ranks in every.items()},
    )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    first = results["cameras"]["cameras"][0]
    number = np.arange(1, PARAMETER_COUNT + 1)
    rows = {"five generic points": first["five"]}
    rows |= {f"six {label}": first["six"][name] for name, label in SETS.items()}
    curves = [
        make_curve(
            label, number + 0.12 * (style - 1.5), np.maximum(sigma, 1e-18), style, marks=True
        )
        for style, (label, sigma) in enumerate(rows.items())
    ]
    levels = [("unobservable below", RANK_TOLERANCE)]
    panel = Panel(
        "number of the singular value", "$\\sigma_i / \\sigma_1$ of M", curves, levels, log_y=True
    )
    yield ReportFigure("rank", [0], Figure("Observability of a", [panel]))
