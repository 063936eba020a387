"""Check of Lemma 1: nine parameters of a camera, and the observations that determine them.

Experiment `lemma-1`. The cameras are pinholes without noise. The points are in general position, in
a plane, and in a plane that contains the RCM.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.projection import (
    PARAMETER_COUNT,
    build_regressor,
    extract_parameters,
    project,
)
from rcmservo.interfaces import Floats
from rcmservo.paper.lab.cameras import project_point, random_camera
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts

RANK_TOLERANCE = 1e-9
"""Singular value, relative to the largest one, that counts as zero; M has columns of length 1."""
POINT_SETS = {
    "generic": "generic points",
    "coplanar": "points of a plane",
    "through": "points of a plane through the RCM",
}


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", partial(observe_cameras, settings=settings))]


def observe_cameras(settings: Settings) -> TaskResult:
    """Return the results of `observe_camera` for each camera."""
    return {"cameras": [observe_camera(settings, seed) for seed in range(settings.cameras)]}


def observe_camera(settings: Settings, seed: int) -> TaskResult:
    """Return the reprojection error (px) of a and o_c, and singular values of M (24)."""
    C, p0 = random_camera(seed)
    a, o_c = extract_parameters(C)
    sets = draw_point_sets(settings, seed, p0)
    errors = [np.linalg.norm(project(a, p) + o_c - project_point(C, p)) for p in sets["generic"]]
    return {
        "reprojection": np.max(errors),
        "five": singular_values(C, o_c, sets["generic"][:5]),
        "six": {name: singular_values(C, o_c, points[:6]) for name, points in sets.items()},
        "all": {name: singular_values(C, o_c, points) for name, points in sets.items()},
    }


def draw_point_sets(settings: Settings, seed: int, p0: Floats) -> dict[str, Floats]:
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


def count_rank(sigma: Floats) -> int:
    return int(np.sum(sigma > RANK_TOLERANCE))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    cameras, seeds = results["cameras"]["cameras"], range(settings.cameras)
    yield Measurement("nine-enough", max(camera["reprojection"] for camera in cameras), seeds)
    five = [count_rank(camera["five"]) for camera in cameras]
    six, every = (
        {name: [count_rank(camera[size][name]) for camera in cameras] for name in POINT_SETS}
        for size in ("six", "all")
    )
    yield Measurement("nine-independent", min(six["generic"]), seeds)
    is_enough = min(five) == PARAMETER_COUNT
    yield Measurement("six-needed", max(five), seeds, confirmed=is_enough, five=min(five))
    coplanar = six["coplanar"]
    largest_ranks = Texts(
        six={name: max(ranks) for name, ranks in six.items()},
        every={name: max(ranks) for name, ranks in every.items()},
    )
    is_deficient = max(coplanar) < PARAMETER_COUNT
    yield Measurement("six-enough", min(coplanar), seeds, confirmed=is_deficient, **largest_ranks)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    camera, number = results["cameras"]["cameras"][0], np.arange(1, PARAMETER_COUNT + 1)
    sigmas = {"five generic points": camera["five"]}
    sigmas |= {f"six {label}": camera["six"][name] for name, label in POINT_SETS.items()}
    curves = list[Curve]()
    for style, (label, sigma) in enumerate(sigmas.items()):
        x = number + 0.12 * (style - 1.5)
        curves.append(make_curve(label, x, np.maximum(sigma, 1e-18), style, marks=True))
    x_label, y_label = "number of the singular value", "$\\sigma_i / \\sigma_1$ of M"
    levels = [("unobservable below", RANK_TOLERANCE)]
    panel = Panel(x_label, y_label, curves, levels, log_y=True)
    yield PaperFigure("rank", [0], Figure("Observability of a", [panel]))
