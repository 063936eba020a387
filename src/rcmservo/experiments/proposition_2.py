"""Proposition 2, as a measurement: R falls along the flow rule (28), as far as J does not change on
the way.

Tried on the exact flow, without noise, along loops of two sizes before a true camera, at several
speeds.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.interfaces import Floats
from rcmservo.method.controller import scaled
from rcmservo.method.estimators.flow import learn
from rcmservo.method.features import SCALE, difference, features
from rcmservo.method.kinematics import axis
from rcmservo.sim import Rig, RigSettings

RISE = 0.1
"""Of R_i(0), by which R_i may get above its running minimum: J's own changes about a converged Ĵ
do not reach it."""


@dataclass(frozen=True)
class Settings:
    """Loops of two sizes at several speeds."""

    seeds: tuple[int, ...] = (0, 1, 2, 3)
    """Of the scenes, two loops in each."""
    radii: tuple[float, float] = (3.0, 30.0)
    """mm."""
    speeds: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0, 100.0)
    """mm/s, slowest first."""
    gamma: float = 0.001
    """γ of the flow rule."""
    step: float = 0.1
    """mm between two frames."""
    path: float = 1000.0
    """mm, round and round."""


@dataclass(frozen=True)
class FallOfR:
    """R_i of (29) along the flow rule at one speed."""

    path: JsonFloats
    """mm."""
    R: JsonFloats
    """Mean over i of R_i/R_i(0)."""
    rise: float
    """How far an R_i gets above its running minimum, in R_i(0), at most."""
    share: float
    """Of the steps in which an R_i rises."""
    end: float
    """Mean over i of R_i/R_i(0) at the end."""


@dataclass(frozen=True)
class Loop:
    """What the flow rule does on one loop."""

    change: float
    """How far J gets from J at the start, of ‖J‖."""
    speeds: list[FallOfR]
    """At every speed."""
    constant: float
    """The largest rise were J constant."""


@dataclass(frozen=True)
class SceneLoops:
    """Both loops of one scene."""

    small: Loop
    """With the first of the radii."""
    large: Loop
    """With the second of the radii."""


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(f"loops-{seed}", partial(loops, settings=settings, seed=seed), cost=5.0)
        for seed in settings.seeds
    ]


@dataclass(frozen=True)
class LoopWay:
    """One round of a closed path, step by step."""

    dp: Floats
    """mm (n, 3)."""
    dy: Floats
    """(n, 3)."""
    J: Floats
    """At the steps' ends, (n, 3, 3)."""
    J_start: Floats
    """(3, 3)."""


def loop_way(rig: Rig, radius: float, step: float) -> LoopWay:
    """A closed curve in all three directions about the scene's start, through the true camera."""
    p0, n = rig.body.points(rig.scene.start)[0], axis(rig.settings.mechanism.rcm(), rig.scene.start)
    t1 = np.linalg.svd(n[None])[2][1]
    t2 = np.cross(n, t1)
    turn = np.linspace(0.0, 2.0 * np.pi, round(11.0 * radius / step) + 1)
    directions = (
        np.outer(np.cos(turn), t1) + np.outer(np.sin(turn), t2) + np.outer(np.cos(2.0 * turn), n)
    )
    p = p0 + radius * directions
    joints = [rig.body.mechanism.joints(one) for one in p]
    o_c = rig.truth.imaged_rcm()
    y = [features((rig.truth.pixels(q) - o_c).ravel()) for q in joints]
    J = np.array([rig.truth.jacobian(q, o_c) for q in joints])
    dy = np.array([difference(after, before) for before, after in pairwise(y)])
    return LoopWay(np.diff(p, axis=0), dy, J[1:], J[0])


def loops(folder: Path, settings: Settings, seed: int) -> SceneLoops:
    """What `on_loop` finds of both loops."""
    del folder
    rig = Rig(seed, RigSettings(), pictures=False)
    small, large = (
        on_loop(loop_way(rig, radius, settings.step), settings) for radius in settings.radii
    )
    return SceneLoops(small, large)


def on_loop(way: LoopWay, settings: Settings) -> Loop:
    """The flow rule on one loop, and on the same were J constant."""
    change = np.linalg.norm((way.J - way.J_start) / SCALE[:, None], axis=(1, 2))
    same = np.broadcast_to(way.J_start, way.J.shape)
    constant = LoopWay(way.dp, way.dp @ way.J_start.T, same, way.J_start)
    return Loop(
        change=float(np.max(change) / np.linalg.norm(scaled(way.J_start))),
        speeds=[fall_of_R(way, settings, speed) for speed in settings.speeds],
        constant=max(fall_of_R(constant, settings, speed).rise for speed in settings.speeds),
    )


def fall_of_R(way: LoopWay, settings: Settings, speed: float) -> FallOfR:
    """R_i (29) over `path` mm of rounds at a constant speed (mm/s), from Ĵ = 0."""
    lengths: Floats = np.linalg.norm(way.dp, axis=1)
    count = round(settings.path / float(np.mean(lengths)))
    J_hat, along = np.zeros((3, 3)), [0.0]
    R: list[Floats] = [np.sum(way.J_start**2, axis=1)]
    for k in range(count):
        i = k % len(lengths)
        J_hat = learn(J_hat, way.dp[i], way.dy[i], lengths[i] / speed, settings.gamma)
        off: Floats = J_hat - way.J[i]
        R.append(np.sum(off**2, axis=1))
        along.append(along[-1] + float(lengths[i]))
    return _descent(np.array(along), np.array(R) / R[0])


def _descent(along: Floats, ratio: Floats) -> FallOfR:
    """R_i/R_i(0) (n, 3) in a few numbers, and thinned for the figure."""
    thin = slice(None, None, max(1, len(along) // 400))
    return FallOfR(
        path=along[thin],
        R=ratio.mean(axis=1)[thin],
        rise=float(np.max(ratio - np.minimum.accumulate(ratio, axis=0))),
        share=float(np.mean(np.diff(ratio, axis=0) > 0.0)),
        end=float(ratio[-1].mean()),
    )


@dataclass(frozen=True)
class LoopsFound:
    """All scenes, and how to ask them."""

    settings: Settings
    """Which speeds there are; they count from the slowest."""
    small: list[Loop]
    """The small loop of every scene."""
    large: list[Loop]
    """The large loop of every scene."""

    def told(self, values: Mapping[float, float], form: str) -> str:
        """Numbers by speed, in words."""
        return ", ".join(f"{speed:g}: {value:{form}}" for speed, value in values.items())

    def rises(self, loops: list[Loop]) -> dict[float, float]:
        """The largest rise at every speed."""
        speeds = enumerate(self.settings.speeds)
        return {speed: max(one.speeds[i].rise for one in loops) for i, speed in speeds}


def chapter(settings: Settings, results: Results) -> Chapter:
    runs = results.all(SceneLoops, "loops", settings.seeds)
    found = LoopsFound(settings, [run.small for run in runs], [run.large for run in runs])
    claims = [
        falls_when_slow(found),
        never_rises_at_constant_J(found),
        slower_is_better(found),
        learns_in_real_time(found),
        change_of_J_matters(found),
    ]
    return Chapter(claims, [_figure(found)])


def falls_when_slow(found: LoopsFound) -> Claim:
    settings, rises = found.settings, found.rises(found.small)
    slow, change = settings.speeds[0], max(one.change for one in found.small)
    shares = {
        speed: float(np.mean([one.speeds[i].share for one in found.small]))
        for i, speed in enumerate(settings.speeds)
    }
    return Claim(
        f"at {slow:g} mm/s on a loop of {settings.radii[0]:g} mm radius R_i falls and does not get "
        f"{RISE:g} R_i(0) above its running minimum: largest rise",
        "stable-28",
        rises[slow],
        "of R_i(0)",
        "<=",
        RISE,
        settings.seeds,
        remark=f"J changes by up to {100.0 * change:.0f} % along that loop, and while Ĵ has not "
        "learnt yet R_i follows J's size up and down",
        detail=f"largest rise by speed in mm/s: {found.told(rises, '.2f')}; share of the steps in "
        f"which an R_i rises: {found.told(shares, '.2f')}",
        figure="R",
        trap="T7",
        confirmed=rises[slow] > RISE,
    )


def never_rises_at_constant_J(found: LoopsFound) -> Claim:
    return Claim(
        "where J is constant, R_i of (29) never rises along the flow rule (28): largest rise",
        "stable-28",
        max(one.constant for one in (*found.small, *found.large)),
        "of R_i(0)",
        "<=",
        1e-12,
        found.settings.seeds,
        detail="at all speeds along both loops",
    )


def slower_is_better(found: LoopsFound) -> Claim:
    rises, wide = found.rises(found.small), found.rises(found.large)
    slow, fast = found.settings.speeds[0], found.settings.speeds[-1]
    return Claim(
        f"the slower the motion, the less R_i rises: {slow:g} mm/s against {fast:g} mm/s, ratio of "
        "the largest rises",
        "stable-28",
        rises[slow] / rises[fast],
        "x the rise",
        "<=",
        1.0,
        found.settings.seeds,
        follows=True,
        remark="over a length of path J changes by the same at any speed, while what is learnt "
        "grows with γ v: slow motion makes it worse",
        detail=f"largest rise in R_i(0), by speed in mm/s: {found.told(rises, '.2f')}; on the "
        f"large loop {found.told(wide, '.2f')}",
        figure="R",
        trap="T7",
        confirmed=rises[slow] > rises[fast],
    )


def change_of_J_matters(found: LoopsFound) -> Claim:
    small, large = (f"{radius:g}" for radius in found.settings.radii)
    pairs = zip(found.large, found.small, strict=True)
    change = [max(one.change for one in loops) for loops in (found.large, found.small)]
    return Claim(
        "what makes R_i rise is how much J changes along the path: it rises at least three times "
        f"as far on the loop of {large} mm as on that of {small} mm",
        OURS,
        median([wide.speeds[0].rise / narrow.speeds[0].rise for wide, narrow in pairs]),
        "x the rise",
        ">=",
        3.0,
        found.settings.seeds,
        detail=f"median over seeds at {found.settings.speeds[0]:g} mm/s; J changes by up to "
        f"{100.0 * change[0]:.0f} % and {100.0 * change[1]:.0f} %",
        figure="R",
    )


def learns_in_real_time(found: LoopsFound) -> Claim:
    settings = found.settings
    slow = settings.speeds[0]
    left = {
        speed: median([one.speeds[i].end for one in found.small])
        for i, speed in enumerate(settings.speeds)
    }
    return Claim(
        f"the flow rule with γ = {settings.gamma:g} computes J at {slow:g} mm/s: what is left of R "
        f"after {settings.path / 1000.0:g} m of path",
        "real-time",
        left[slow],
        "of R(0)",
        "<=",
        0.1,
        settings.seeds,
        follows=True,
        remark="it learns by 1 − exp(−γ v L), so that slow motion hardly teaches",
        detail=f"median on the small loop, by speed in mm/s: {found.told(left, '.2g')}",
        figure="R",
        trap="T7",
        confirmed=left[slow] > 0.1,
    )


def _figure(found: LoopsFound) -> Shown:
    settings = found.settings
    panels = [
        _panel(settings, settings.radii[0], found.small[0], labelled=False),
        _panel(settings, settings.radii[1], found.large[0], labelled=True),
    ]
    caption = (
        "Mean over i of R_i/R_i(0), R_i of (29), along the flow rule (28) from Ĵ = 0 with γ = "
        f"{settings.gamma:g}, without noise, round and round two loops at five speeds."
    )
    figure = Figure("Proposition 2", panels, columns=2)
    return Shown("R", "Proposition 2, (29)-(30)", caption, [settings.seeds[0]], figure)


def _panel(settings: Settings, radius: float, loop: Loop, labelled: bool) -> Panel:
    curves = [
        curve(f"{speed:g} mm/s" if labelled else "", one.path, one.R, style)
        for style, (speed, one) in enumerate(zip(settings.speeds, loop.speeds, strict=True))
    ]
    return Panel(f"path [mm], loop of {radius:g} mm radius", "R / R(0)", curves, log_y=True)


EXPERIMENT = Experiment(
    name="proposition-2",
    title="Proposition 2: the flow rule falls, if J stays",
    about="R of (29) along the flow rule (28), on loops on which J hardly changes and on which "
    "it does.",
    whole=Settings(),
    quick=Settings(seeds=(0,), step=0.5),
    tasks=tasks,
    chapter=chapter,
)
