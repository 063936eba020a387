"""Experiment `proposition-2`: decrease of R along the flow rule (28), as J changes on the path.

The flow is exact and without noise, along closed paths of two sizes, at several speeds.
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
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, median
from rcmservo.sim import Rig, RigSettings

LOOPS = ("small", "large")


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed(
        "loops", partial(loops, settings=settings), range(settings.seeds), cost=5.0
    )


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


def loops(settings: Settings, seed: int) -> TaskResult:
    """Return the results of `on_loop` for both closed paths."""
    rig = Rig(seed, RigSettings(), pictures=False)
    rounds = [loop_round(rig, radius, settings.step) for radius in settings.radii]
    return {name: on_loop(one, settings) for name, one in zip(LOOPS, rounds, strict=True)}


def loop_round(rig: Rig, radius: float, step: float) -> Round:
    """Return a closed path in three dimensions about the start, with true flow and Jacobians."""
    p0, n = (
        rig.body.points(rig.scene.start)[0],
        compute_axis(rig.settings.mechanism.to_struct(), rig.scene.start),
    )
    t1 = np.linalg.svd(n[None])[2][1]
    t2 = np.cross(n, t1)
    turn = np.linspace(0.0, 2.0 * np.pi, round(11.0 * radius / step) + 1)
    directions = (
        np.outer(np.cos(turn), t1) + np.outer(np.sin(turn), t2) + np.outer(np.cos(2.0 * turn), n)
    )
    p = p0 + radius * directions
    joints = [rig.body.mechanism.joints(one) for one in p]
    o_c = rig.truth.imaged_rcm()
    y = [compute_features((rig.truth.pixels(q) - o_c).ravel()) for q in joints]
    J = np.array([rig.truth.jacobian(q, o_c) for q in joints])
    dy = np.array([compute_feature_error(after, before) for before, after in pairwise(y)])
    return Round(np.diff(p, axis=0), dy, J[1:], J[0])


def on_loop(one: Round, settings: Settings) -> TaskResult:
    """Return `fall_of_R` on one closed path at each speed, and its largest rise for constant J.

    ``change`` is the largest difference of J from J at the start, as a fraction of ‖J‖.
    """
    change = np.linalg.norm((one.J - one.J_start) / FEATURE_SCALE[:, None], axis=(1, 2))
    same = np.broadcast_to(one.J_start, one.J.shape)
    constant = Round(one.dp, one.dp @ one.J_start.T, same, one.J_start)
    return {
        "change": np.max(change) / np.linalg.norm(scale_rows(one.J_start)),
        "speeds": [fall_of_R(one, settings, speed) for speed in settings.speeds],
        "constant": max(fall_of_R(constant, settings, v)["rise"] for v in settings.speeds),
    }


def fall_of_R(one: Round, settings: Settings, speed: float) -> TaskResult:
    """Return R_i (29) over R_i(0) along `settings.path` mm of rounds at `speed` (mm/s), from Ĵ = 0.

    ``rise`` is the largest increase of an R_i above its running minimum, ``share`` the fraction of
    the steps in which an R_i rises. ``path`` and ``R`` (the mean over i) are thinned for the
    figure.
    """
    lengths: Floats = np.linalg.norm(one.dp, axis=1)
    J_hat, along = np.zeros((3, 3)), [0.0]
    R: list[Floats] = [np.sum(one.J_start**2, axis=1)]
    for k in range(round(settings.path / float(np.mean(lengths)))):
        i = k % len(lengths)
        J_hat = integrate_flow_rule(J_hat, one.dp[i], one.dy[i], lengths[i] / speed, settings.gamma)
        R.append(np.sum((J_hat - one.J[i]) ** 2, axis=1))
        along.append(along[-1] + float(lengths[i]))
    ratio = np.array(R) / R[0]
    thin = slice(None, None, max(1, len(along) // 400))
    return {
        "path": np.array(along)[thin],
        "R": ratio.mean(axis=1)[thin],
        "rise": np.max(ratio - np.minimum.accumulate(ratio, axis=0)),
        "share": np.mean(np.diff(ratio, axis=0) > 0.0),
        "end": ratio[-1].mean(),
    }


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    runs, seeds = results.per_seed("loops", range(settings.seeds)), range(settings.seeds)
    rises, fractions, ends = (
        _by_speed(runs, settings, "small", name) for name in ("rise", "share", "end")
    )
    wide = _by_speed(runs, settings, "large", "rise")
    change = {loop: 100.0 * column(runs, loop, "change").max() for loop in LOOPS}

    def listed(values: Floats, form: str) -> str:
        pairs = zip(settings.speeds, values, strict=True)
        return ", ".join(f"{speed:g}: {value:{form}}" for speed, value in pairs)

    most, most_wide = rises.max(axis=1), wide.max(axis=1)
    yield Measurement(
        "falls-when-slow",
        most[0],
        seeds,
        confirmed=most[0] > settings.rise,
        change=change["small"],
        rises=listed(most, ".2f"),
        shares=listed(fractions.mean(axis=1), ".2f"),
    )
    yield Measurement(
        "constant-J", max(column(runs, loop, "constant").max() for loop in LOOPS), seeds
    )
    yield Measurement(
        "slower-is-better",
        most[0] / most[-1],
        seeds,
        confirmed=most[0] > most[-1],
        fastest=settings.speeds[-1],
        rises=listed(most, ".2f"),
        wide=listed(most_wide, ".2f"),
    )
    left = np.median(ends, axis=1)
    yield Measurement(
        "real-time",
        left[0],
        seeds,
        confirmed=left[0] > 0.1,
        metres=settings.path / 1000.0,
        left=listed(left, ".2g"),
    )
    yield Measurement("change-of-J", median(wide[0] / rises[0]), seeds, **change)


def _by_speed(runs: list[TaskResult], settings: Settings, loop: str, name: str) -> Floats:
    """Return a result (speeds, scenes) for each speed and scene."""
    indices = range(len(settings.speeds))
    return np.array([[run[loop]["speeds"][i][name] for run in runs] for i in indices])


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    panels = [
        Panel(
            f"path [mm], loop of {radius:g} mm radius",
            "R / R(0)",
            [
                make_curve(
                    f"{speed:g} mm/s" if loop == "large" else "", one["path"], one["R"], style
                )
                for style, (speed, one) in enumerate(
                    zip(settings.speeds, results["loops-0"][loop]["speeds"], strict=True)
                )
            ],
            log_y=True,
        )
        for radius, loop in zip(settings.radii, LOOPS, strict=True)
    ]
    yield ReportFigure("R", [0], Figure("Proposition 2", panels, columns=2))
