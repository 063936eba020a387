"""Lemma 1, as a measurement: a camera is known by nine parameters, and which observations tell all
nine.

Tried on noiseless pinhole cameras, with points in general position, in a plane, and in a plane that
holds the RCM.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.cameras import drawn, seen_by
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
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
    """Points before several cameras."""

    cameras: tuple[int, ...] = tuple(range(20))
    """Seeds."""
    points: int = 100
    """Before each camera."""
    spread: float = 20.0
    """mm about the tool's start within which they lie."""


@dataclass(frozen=True)
class NineParameters:
    """How well a and o_c stand for one camera, and what its points tell of a."""

    reprojection: float
    """Largest distance px from the pixels of C."""
    five: JsonFloats
    """Scaled singular values of M for five generic points."""
    six: dict[str, JsonFloats]
    """The same for six points that lie as SETS say."""
    all: dict[str, JsonFloats]
    """The same for all points."""


@dataclass(frozen=True)
class AllCameras:
    """The numbers of all cameras."""

    found: list[NineParameters]
    """Of every camera, in the order of the seeds."""


def tasks(settings: Settings) -> list[Task]:
    return [Task("cameras", partial(all_cameras, settings=settings))]


def all_cameras(folder: Path, settings: Settings) -> AllCameras:
    """What `nine_parameters` finds of every camera."""
    del folder
    return AllCameras([nine_parameters(settings, seed) for seed in settings.cameras])


def nine_parameters(settings: Settings, seed: int) -> NineParameters:
    """How well a and o_c stand for C, and the scaled singular values of M."""
    C, p0 = drawn(seed)
    a, o_c = parameters(C)
    sets = point_sets(settings, seed, p0)
    away = [np.linalg.norm(project(a, p) + o_c - seen_by(C, p)) for p in sets["generic"]]
    return NineParameters(
        reprojection=float(np.max(away)),
        five=singular_values(C, o_c, sets["generic"][:5]),
        six={name: singular_values(C, o_c, points[:6]) for name, points in sets.items()},
        all={name: singular_values(C, o_c, points) for name, points in sets.items()},
    )


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


def singular_values(C: Floats, o_c: Floats, points: Floats) -> Floats:
    """Singular values over the largest of M (24), its columns scaled to length 1, for the points
    (n, 3)."""
    M = np.concatenate([regressor(seen_by(C, p) - o_c, p) for p in points])
    sigma = np.linalg.svd(M / np.linalg.norm(M, axis=0), compute_uv=False)
    return sigma / sigma[0]


def rank(sigma: Floats) -> int:
    return int(np.sum(sigma > RANK_TOLERANCE))


def chapter(settings: Settings, results: Results) -> Chapter:
    found = results.of(AllCameras, "cameras").found
    claims = [
        nine_are_enough(settings, found),
        nine_are_independent(settings, found),
        six_are_needed(settings, found),
        six_give_full_rank(settings, found),
    ]
    return Chapter(claims, [_figure(settings, found)])


def nine_are_enough(settings: Settings, found: list[NineParameters]) -> Claim:
    return Claim(
        "nine parameters a and o_c give the pixels of C: largest distance",
        "lemma-1",
        max(one.reprojection for one in found),
        "px",
        "<=",
        1e-6,
        settings.cameras,
        detail=f"largest of {settings.points} points each before {len(found)} drawn cameras "
        "without distortion",
    )


def nine_are_independent(settings: Settings, found: list[NineParameters]) -> Claim:
    return Claim(
        "the nine are independent: M has rank 9 for six points in general position",
        "lemma-1",
        min(rank(one.six["generic"]) for one in found),
        "rank",
        ">=",
        PARAMETERS,
        settings.cameras,
        detail=f"least over {len(found)} cameras, with columns scaled to length 1",
        figure="rank",
    )


def six_are_needed(settings: Settings, found: list[NineParameters]) -> Claim:
    five = [rank(one.five) for one in found]
    return Claim(
        "five observations leave the rank of M below 9",
        "six",
        max(five),
        "rank",
        "<=",
        PARAMETERS - 1,
        settings.cameras,
        remark=f"five points in general position give rank {min(five)} in every camera: ten "
        "equations for nine unknowns",
        figure="rank",
        trap="T9",
        confirmed=min(five) == PARAMETERS,
    )


def six_give_full_rank(settings: Settings, found: list[NineParameters]) -> Claim:
    six, whole = (
        {name: [rank(sigmas[name]) for sigmas in some] for name in SETS}
        for some in ([one.six for one in found], [one.all for one in found])
    )
    return Claim(
        "six observations that are not collinear give M rank 9, also where they lie in a plane",
        "rank",
        min(six["coplanar"]),
        "rank",
        ">=",
        PARAMETERS,
        settings.cameras,
        remark=f"points of one plane leave rank {max(six['coplanar'])}, and rank "
        f"{max(six['through'])} if the plane holds the RCM; {settings.points} of them do no "
        f"better (rank {max(whole['coplanar'])} and {max(whole['through'])})",
        figure="rank",
        trap="T9",
        confirmed=max(six["coplanar"]) < PARAMETERS,
    )


def _figure(settings: Settings, found: list[NineParameters]) -> Shown:
    seed, first = settings.cameras[0], found[0]
    number = np.arange(1, PARAMETERS + 1)
    rows = {"five generic points": first.five}
    rows |= {f"six {label}": first.six[name] for name, label in SETS.items()}
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
        "general position, in a plane, and in a plane that holds the RCM. Each that is zero is a "
        "direction of a that was not observed."
    )
    figure = Figure("What observations tell of a", [panel])
    return Shown("rank", "Proposition 1, (25)", caption, [seed], figure)


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
