"""Lemma 1, as a measurement: a camera is known by nine parameters, and which observations tell all
nine.

Tried on noiseless pinhole cameras, with points in general position, in a plane, and in a plane that
holds the RCM.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.cameras import drawn, seen_by
from rcmservo.experiments.harness.claims import Chapter, Claim, Experiment, Results, Shown, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.projection import PARAMETERS, parameters, project, regressor

RANK_TOLERANCE = 1e-9
"""Singular value over the largest, of M with columns of length 1, below which a direction is not
observed."""

SETS = {
    "generic": "generic points",
    "coplanar": "points of a plane",
    "through": "points of a plane that holds the RCM",
}


@dataclass(frozen=True)
class Settings:
    """``cameras`` are seeds, ``spread`` mm that of the ``points`` before each."""

    cameras: tuple[int, ...] = tuple(range(20))
    points: int = 100
    spread: float = 20.0


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", all_cameras, {"settings": settings})]


def all_cameras(folder: Path, settings: Settings) -> dict[str, Any]:
    """What `nine_parameters` finds of every camera."""
    del folder
    return {str(seed): nine_parameters(settings, seed) for seed in settings.cameras}


def nine_parameters(settings: Settings, seed: int) -> dict[str, Any]:
    """How well a and o_c stand for C, and the scaled singular values of M for points that lie as
    `SETS` say."""
    C, p0 = drawn(seed)
    a, o_c = parameters(C)
    sets = point_sets(settings, seed, p0)
    return {
        "reprojection": max(
            float(np.linalg.norm(project(a, p) + o_c - seen_by(C, p))) for p in sets["generic"]
        ),
        "five": singular_values(C, o_c, sets["generic"][:5]),
        "six": {name: singular_values(C, o_c, points[:6]) for name, points in sets.items()},
        "all": {name: singular_values(C, o_c, points) for name, points in sets.items()},
    }


def point_sets(settings: Settings, seed: int, p0: Floats) -> dict[str, Floats]:
    """Points (n, 3) mm about p0 (3,): drawn, then laid into a plane, and into one that holds the
    RCM."""
    random = np.random.default_rng([seed, 1])
    points = p0 + settings.spread * random.uniform(-1.0, 1.0, (settings.points, 3))
    normal = random.standard_normal(3)
    normal /= np.linalg.norm(normal)
    aside = normal - p0 * (normal @ p0) / (p0 @ p0)
    aside /= np.linalg.norm(aside)
    return {
        "generic": points,
        "coplanar": points - np.outer((points - p0) @ normal, normal),
        "through": points - np.outer(points @ aside, aside),
    }


def singular_values(C: Floats, o_c: Floats, points: Floats) -> list[float]:
    """Singular values over the largest of M (24), its columns scaled to length 1, for the points
    (n, 3)."""
    M = np.concatenate([regressor(seen_by(C, p) - o_c, p) for p in points])
    sigma = np.linalg.svd(M / np.linalg.norm(M, axis=0), compute_uv=False)
    return (sigma / sigma[0]).tolist()


def rank(sigma: list[float]) -> int:
    return int(np.sum(np.array(sigma) > RANK_TOLERANCE))


def chapter(settings: Settings, results: Results) -> Chapter:
    values = results["cameras"].values
    return Chapter(_claims(settings, values), [_figure(settings, values)])


def _claims(settings: Settings, values: dict[str, Any]) -> list[Claim]:
    seeds = settings.cameras
    six, whole = (
        {name: [rank(one[key][name]) for one in values.values()] for name in SETS}
        for key in ("six", "all")
    )
    five = [rank(one["five"]) for one in values.values()]
    return [
        Claim(
            "a camera that sees an RCM mechanism is known by nine parameters a and o_c: they "
            "give the pixels of C",
            "Lemma 1",
            max(one["reprojection"] for one in values.values()),
            "px",
            "<=",
            1e-6,
            seeds,
            detail=f"largest of {settings.points} points each before {len(seeds)} drawn cameras "
            f"without distortion",
        ),
        Claim(
            "the nine parameters are independent: M has rank 9 for six points in general position",
            "Lemma 1, (24)",
            min(six["generic"]),
            "rank",
            ">=",
            PARAMETERS,
            seeds,
            detail=f"least over {len(seeds)} cameras, with columns scaled to length 1",
            figure="rank",
        ),
        Claim(
            "P ≥ 6 observations are needed: five leave the rank of M below 9",
            "III-B",
            max(five),
            "rank",
            "<=",
            PARAMETERS - 1,
            seeds,
            remark=f"five points in general position give rank {min(five)} in every camera: ten "
            f"equations for nine "
            "unknowns",
            figure="rank",
            trap="T9",
            confirmed=min(five) == PARAMETERS,
        ),
        Claim(
            "six non-collinear observations give M full column rank",
            "Proposition 1, (25)",
            min(six["coplanar"]),
            "rank",
            ">=",
            PARAMETERS,
            seeds,
            remark=f"points of one plane are not collinear and leave rank "
            f"{max(six['coplanar'])}, and rank "
            f"{max(six['through'])} if the plane holds the RCM; {settings.points} of them do no "
            f"better "
            f"(rank {max(whole['coplanar'])} and {max(whole['through'])})",
            figure="rank",
            trap="T9",
            confirmed=max(six["coplanar"]) < PARAMETERS,
        ),
    ]


def _figure(settings: Settings, values: dict[str, Any]) -> Shown:
    seed = settings.cameras[0]
    number = np.arange(1, PARAMETERS + 1)
    rows = {"five generic points": values[str(seed)]["five"]}
    rows |= {f"six {label}": values[str(seed)]["six"][name] for name, label in SETS.items()}
    curves = [
        curve(label, number + 0.12 * (style - 1.5), np.maximum(sigma, 1e-18), style, marks=True)
        for style, (label, sigma) in enumerate(rows.items())
    ]
    panel = Panel(
        "number of the singular value",
        "$\\sigma_i / \\sigma_1$ of M",
        curves,
        log_y=True,
        levels=[("not observed below this", RANK_TOLERANCE)],
    )
    caption = (
        "Singular values of M (24), its columns scaled to length 1, for points that lie in "
        "general position, in a "
        "plane, and in a plane that holds the RCM. Each that is zero is a direction of a that "
        "was not observed."
    )
    return Shown(
        "rank",
        "Proposition 1, (25)",
        caption,
        [seed],
        Figure("What observations tell of a", [panel]),
    )


EXPERIMENT = Experiment(
    name="lemma-1",
    title="Lemma 1: nine parameters",
    about="The nine parameters of a camera that sees an RCM mechanism, and the observations that "
    "tell them.",
    whole=Settings(),
    quick=Settings(cameras=(0, 1, 2)),
    tasks=tasks,
    chapter=chapter,
)
