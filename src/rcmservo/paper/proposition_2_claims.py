"""Check of Proposition 2: R decreases along the flow rule (28), as J changes on the path.

Experiment `proposition-2`; the rule itself is in estimation/flow_rule.py. The flow is exact and
without noise, along closed paths of two sizes, at several speeds.
"""

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.estimation.flow_rule import integrate_flow_rule
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.features import FEATURE_SCALE, compute_feature_error, compute_features
from rcmservo.geometry.kinematics import compute_axis
from rcmservo.interfaces import Floats
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, median
from rcmservo.sim import Rig, RigSettings

PATH_SIZES = ("small", "large")


def tasks(settings: Settings) -> list[Task]:
    work = partial(follow_closed_paths, settings=settings)
    return Task.per_seed("loops", work, range(settings.seeds), cost=5.0)


class Round(NamedTuple):
    """One round of a closed path in n steps.

    Parameters
    ----------
    dp : Floats
        Displacements (n, 3) of marker 1 in mm.
    dy : Floats
        Changes (n, 3) of y in rad, px, px.
    J : Floats
        True Jacobians (n, 3, 3) at the ends of the steps.
    J_start : Floats
        True Jacobian (3, 3) at the start.
    """

    dp: Floats
    dy: Floats
    J: Floats
    J_start: Floats


def follow_closed_paths(settings: Settings, seed: int) -> TaskResult:
    """Return the results of `follow_closed_path` for both sizes of the path."""
    rig = Rig(seed, RigSettings(), pictures=False)
    rounds = [make_round(rig, radius, settings.step) for radius in settings.radii]
    pairs = zip(PATH_SIZES, rounds, strict=True)
    return {size: follow_closed_path(path_round, settings) for size, path_round in pairs}


def make_round(rig: Rig, radius: float, step: float) -> Round:
    """Return a closed path in three dimensions about the start, with true flow and Jacobians."""
    p0 = rig.body.points(rig.scene.start)[0]
    n = compute_axis(rig.settings.mechanism.to_struct(), rig.scene.start)
    t1 = np.linalg.svd(n[None])[2][1]
    t2 = np.cross(n, t1)
    angle = np.linspace(0.0, 2.0 * np.pi, round(11.0 * radius / step) + 1)
    sideways = np.outer(np.cos(angle), t1) + np.outer(np.sin(angle), t2)
    p = p0 + radius * (sideways + np.outer(np.cos(2.0 * angle), n))
    joints = [rig.body.mechanism.joints(p1) for p1 in p]
    o_c = rig.truth.imaged_rcm()
    y = [compute_features((rig.truth.pixels(q) - o_c).ravel()) for q in joints]
    J = np.array([rig.truth.jacobian(q, o_c) for q in joints])
    dy = np.array([compute_feature_error(after, before) for before, after in pairwise(y)])
    return Round(np.diff(p, axis=0), dy, J[1:], J[0])


def follow_closed_path(path_round: Round, settings: Settings) -> TaskResult:
    """Return `integrate_flow_rule_on` a path at each speed, and the largest rise for constant J.

    ``change`` is the largest difference of J from J at the start, as a fraction of ‖J‖.
    """
    dp, _, J, J_start = path_round
    change = np.linalg.norm((J - J_start) / FEATURE_SCALE[:, None], axis=(1, 2))
    constant = Round(dp, dp @ J_start.T, np.broadcast_to(J_start, J.shape), J_start)
    rises = [integrate_flow_rule_on(constant, settings, v)["rise"] for v in settings.speeds]
    return {
        "change": np.max(change) / np.linalg.norm(scale_rows(J_start)),
        "speeds": [integrate_flow_rule_on(path_round, settings, v) for v in settings.speeds],
        "constant": max(rises),
    }


def integrate_flow_rule_on(path_round: Round, settings: Settings, speed: float) -> TaskResult:
    """Return R_i (29) over R_i(0) along `settings.path` mm of rounds at `speed` (mm/s), from Ĵ = 0.

    ``rise`` is the largest increase of an R_i above its running minimum, ``share`` the fraction of
    the steps in which an R_i rises. ``path`` (mm) and ``R`` (the mean over i) are thinned for the
    figure.
    """
    dp, dy, J, J_start = path_round
    lengths: Floats = np.linalg.norm(dp, axis=1)
    J_hat, along = np.zeros((3, 3)), [0.0]
    R: list[Floats] = [np.sum(J_start**2, axis=1)]
    for k in range(round(settings.path / float(np.mean(lengths)))):
        i = k % len(lengths)
        J_hat = integrate_flow_rule(J_hat, dp[i], dy[i], lengths[i] / speed, settings.gamma)
        difference: Floats = J_hat - J[i]
        R.append(np.sum(difference**2, axis=1))
        along.append(along[-1] + float(lengths[i]))
    ratio = np.array(R) / R[0]
    thinned = slice(None, None, max(1, len(along) // 400))
    return {
        "path": np.array(along)[thinned],
        "R": ratio.mean(axis=1)[thinned],
        "rise": np.max(ratio - np.minimum.accumulate(ratio, axis=0)),
        "share": np.mean(np.diff(ratio, axis=0) > 0.0),
        "end": ratio[-1].mean(),
    }


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    runs, seeds = results.per_seed("loops", range(settings.seeds)), range(settings.seeds)

    def by_speed(size: str, name: str) -> Floats:
        """Return a result (speeds, scenes) for each speed and scene."""
        indices = range(len(settings.speeds))
        return np.array([[run[size]["speeds"][i][name] for run in runs] for i in indices])

    def list_by_speed(values: Floats, form: str) -> str:
        pairs = zip(settings.speeds, values, strict=True)
        return ", ".join(f"{speed:g}: {value:{form}}" for speed, value in pairs)

    rises, wide = by_speed("small", "rise"), by_speed("large", "rise")
    largest, shares = rises.max(axis=1), by_speed("small", "share").mean(axis=1)
    change = Texts({size: 100.0 * column(runs, size, "change").max() for size in PATH_SIZES})
    listed = list_by_speed(largest, ".2f")
    texts = Texts(change=change["small"], rises=listed, shares=list_by_speed(shares, ".2f"))
    rises_much = largest[0] > settings.rise
    yield Measurement("falls-when-slow", largest[0], seeds, confirmed=rises_much, **texts)
    constant = max(column(runs, size, "constant").max() for size in PATH_SIZES)
    yield Measurement("constant-J", constant, seeds)
    ratio, listed_wide = largest[0] / largest[-1], list_by_speed(wide.max(axis=1), ".2f")
    texts = Texts(fastest=settings.speeds[-1], rises=listed, wide=listed_wide)
    slow_is_worse = largest[0] > largest[-1]
    yield Measurement("slower-is-better", ratio, seeds, confirmed=slow_is_worse, **texts)
    remaining = np.median(by_speed("small", "end"), axis=1)
    texts = Texts(metres=settings.path / 1000.0, left=list_by_speed(remaining, ".2g"))
    yield Measurement("real-time", remaining[0], seeds, confirmed=remaining[0] > 0.1, **texts)
    yield Measurement("change-of-J", median(wide[0] / rises[0]), seeds, **change)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    panels = list[Panel]()
    for radius, size in zip(settings.radii, PATH_SIZES, strict=True):
        runs = zip(settings.speeds, results["loops-0"][size]["speeds"], strict=True)
        curves = [
            make_curve(f"{speed:g} mm/s" if size == "large" else "", run["path"], run["R"], style)
            for style, (speed, run) in enumerate(runs)
        ]
        label = f"path [mm], loop of {radius:g} mm radius"
        panels.append(Panel(label, "R / R(0)", curves, log_y=True))
    yield PaperFigure("R", [0], Figure("Proposition 2", panels, columns=2))
