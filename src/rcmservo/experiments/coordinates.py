"""What the joints' coordinates cost: pitch and yaw, or the paper's spherical ones, which are
singular at θ = 0.

Once as the joint rates that a motion near the pole demands, and once in closed loops that pass the
pole.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.cameras import PINHOLE
from rcmservo.experiments.harness.lab.closed_loop import NOISE
from rcmservo.experiments.harness.lab.witness import Trial, settle, why_not
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import known, marks, median, told
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.gate import Gate
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick
from rcmservo.method.kinematics import JointLimits, Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.sim import RigSettings

HANGING = SphericalRcm(
    JointLimits((0.5 * np.pi, -2.0 * np.pi, 40.0), (1.5 * np.pi, 2.0 * np.pi, 240.0))
)
"""Spherical joints with the pole inside their limits, and the tool hanging down as a pitch and yaw
arm's does."""

KEPT = replace(
    HANGING, limits=replace(HANGING.limits, upper=(float(np.radians(172.0)), 2.0 * np.pi, 240.0))
)
"""The same with limits that leave 8° about the pole out, as the default's do."""

LABELS = ["pitch and yaw", "spherical"]
ENDS = (30.0, 32.0, 100.0)
"""mm of marker 1: across the pole on either side, and below the RCM."""

NEAR = float(np.radians(5.0))
"""Angle from the pole within which the speed is judged."""


@dataclass(frozen=True)
class Settings:
    """Rates near the pole, and closed loops whose straight way passes it."""

    angles: tuple[float, float] = (float(np.radians(30.0)), float(np.radians(0.1)))
    """rad between tool and pole, greatest and least."""
    depth: float = 100.0
    """mm of marker 1 from the RCM."""
    speed: float = 10.0
    """mm/s across the tool."""
    seeds: tuple[int, ...] = tuple(range(8))
    """Of loops."""
    aside: float = 1.0
    """mm at which the straight way passes the pole."""
    duration: float = 20.0
    """s of a loop."""


@dataclass(frozen=True)
class Passage:
    """One loop from one side of the pole to the other."""

    trial: Trial
    """What the truth says of the loop."""
    nearest: float
    """rad from the pole."""
    kept: float | None
    """Share that the gate left of the law's speed near the pole; None if it never came near."""


@dataclass(frozen=True)
class PoleLoops:
    """The same closed loop with every arm."""

    pitch_yaw: Passage
    """Pitch and yaw, regular at this pole."""
    spherical: Passage
    """The paper's coordinates, with the pole inside their limits."""
    limited: Passage
    """Spherical, with limits that leave the pole out."""


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(f"loop-{seed}", partial(loop, settings=settings, seed=seed)) for seed in settings.seeds
    ]


def loop(folder: Path, settings: Settings, seed: int) -> PoleLoops:
    """The same closed loop past the pole with every arm."""
    del folder
    arms = (PitchYawRcm(), HANGING, KEPT)
    return PoleLoops(*(past_pole(arm, settings, seed) for arm in arms))


def past_pole(arm: Kinematics, settings: Settings, seed: int) -> Passage:
    """One loop from one side of the pole to the other: how near it came, how much of its speed it
    kept, and when it settled."""
    start, target = (tuple(float(x) for x in arm.joints(p1)) for p1 in places(settings, seed))
    laboratory = RigSettings(
        mechanism=arm, scene=replace(PINHOLE, start=start, target=target), point_noise=NOISE
    )
    trial, ticks = settle(seed, laboratory, settings.duration)
    angles = np.array([from_pole(arm, tick) for tick in ticks])
    near = [
        tick
        for tick, angle in zip(ticks, angles, strict=True)
        if tick.state.explored and angle < NEAR
    ]
    return Passage(trial, float(angles.min()), kept_speed(arm, near))


def from_pole(arm: Kinematics, tick: Tick) -> float:
    """Angle rad between the tool and the pole below."""
    p1 = arm.position(tick.seen.q)
    return float(np.arctan2(np.hypot(p1[0], p1[1]), -p1[2]))


def kept_speed(arm: Kinematics, ticks: list[Tick]) -> float | None:
    """The share of the law's speed that the gate let through."""
    sent = sum(
        float(arm.jacobian(tick.seen.q) @ tick.state.command.rates @ tick.state.v) for tick in ticks
    )
    wanted = sum(float(tick.state.v @ tick.state.v) for tick in ticks)
    return sent / wanted if wanted > 0.0 else None


def places(settings: Settings, seed: int) -> list[Floats]:
    """Both ends (3,) mm of marker 1's way past the pole, in a drawn direction."""
    before, after, below = ENDS
    turn = np.random.default_rng(seed).uniform(0.2, np.pi - 0.2)
    along, beside = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    return [
        np.array([*(end * along + settings.aside * beside), -below]) for end in (before, -after)
    ]


def rates(settings: Settings, kinematics: Kinematics, side: float, angles: Floats) -> Floats:
    """What coordinates demand at angles from their pole, which lies on this side of z, rad/s."""
    across = np.array([np.cos(0.7), np.sin(0.7)])
    points = [settings.depth * np.array([*(np.sin(t) * across), side * np.cos(t)]) for t in angles]
    return np.array([demanded(kinematics, p1, settings.speed) for p1 in points])


def demanded(kinematics: Kinematics, p1: Floats, speed: float) -> float:
    """Largest angle rate rad/s that moving marker 1 with `speed` mm/s across the tool may take at
    p1 (3,) mm."""
    jacobian = kinematics.jacobian(kinematics.joints(p1))
    return float(speed / np.min(np.linalg.norm(jacobian[:, :2], axis=0)))


@dataclass(frozen=True)
class PoleLoopsFound:
    """The rates demanded near the pole, and all loops."""

    settings: Settings
    """What the rates and the loops were made with."""
    angles: Floats
    """rad (n,) from θ = 0, or from the home pose of pitch and yaw; greatest first."""
    spherical: Floats
    """The largest joint rate demanded there (n,), rad/s, in spherical coordinates."""
    pitch_yaw: Floats
    """The largest joint rate demanded there (n,), rad/s, in pitch and yaw."""
    loops: list[PoleLoops]
    """One for each seed."""

    @property
    def degrees(self) -> Floats:
        return np.degrees(self.angles)


LIMIT = Gate().speed[0]
"""rad/s that the gate lets an angle turn."""


def chapter(settings: Settings, results: Results) -> Chapter:
    angles = np.geomspace(*settings.angles, 400)
    found = PoleLoopsFound(
        settings,
        angles,
        rates(settings, SphericalRcm(), 1.0, angles),
        rates(settings, PitchYawRcm(), -1.0, angles),
        results.all(PoleLoops, "loop", settings.seeds),
    )
    claims = [spherical_rate(found), keeps_speed(found), settles_as_soon(found), other_rate(found)]
    return Chapter(claims, [_rate_figure(found), _loop_figure(found)])


def spherical_rate(found: PoleLoopsFound) -> Claim:
    settings, rates = found.settings, found.spherical
    beyond = float(np.max(found.degrees[rates > LIMIT], initial=0.0))
    return Claim(
        f"{settings.speed:g} mm/s across the tool, {settings.depth:g} mm from the RCM, stays "
        f"within {LIMIT:g} rad/s in the paper's coordinates down to θ = {found.degrees[-1]:.1f}°",
        "spherical",
        float(rates[-1]),
        "rad/s",
        "<=",
        LIMIT,
        follows=True,
        remark=f"they are singular at θ = 0, where φ turns without end: beyond {LIMIT:g} rad/s "
        f"below {beyond:.1f}°",
        detail=f"{rates[0]:.2g} rad/s at {found.degrees[0]:.0f}°",
        figure="pole-rates",
        trap="T4",
        confirmed=bool(rates[-1] > 100.0 * rates[0]),
    )


def other_rate(found: PoleLoopsFound) -> Claim:
    return Claim(
        f"{found.settings.speed:g} mm/s across the tool stays within {LIMIT:g} rad/s in pitch and "
        "yaw all the way",
        OURS,
        float(np.max(found.pitch_yaw)),
        "rad/s",
        "<=",
        LIMIT,
        figure="pole-rates",
    )


def keeps_speed(found: PoleLoopsFound) -> Claim:
    spherical = median(known(one.spherical.kept for one in found.loops))
    other = median(known(one.pitch_yaw.kept for one in found.loops))
    nearest = np.degrees(median([one.spherical.nearest for one in found.loops]))
    return Claim(
        "a servo run past the pole keeps the speed that the law asks for, in the paper's "
        f"coordinates: share of it within {np.degrees(NEAR):g}° of the pole",
        "spherical",
        spherical,
        "of the speed",
        ">=",
        0.9,
        found.settings.seeds,
        follows=True,
        remark="the gate scales the speed down while φ turns; pitch and yaw keep "
        f"{told(other)} of it",
        detail=f"nearest {nearest:.1f}° from the pole (median)",
        figure="pole-loops",
        trap="T4",
        confirmed=spherical < 0.9 <= other,
    )


def settles_as_soon(found: PoleLoopsFound) -> Claim:
    longest = found.settings.duration
    times = [
        [one.settle_time or longest for one in some]
        for some in (
            [loops.spherical.trial for loops in found.loops],
            [loops.pitch_yaw.trial for loops in found.loops],
        )
    ]
    ratio = median(np.array(times[0]) / np.array(times[1]))
    settled = _settled(found)
    return Claim(
        "a servo run past the pole settles as soon in the paper's coordinates as in pitch and "
        "yaw: time over time",
        "spherical",
        ratio,
        "x the time",
        "<=",
        1.1,
        found.settings.seeds,
        follows=True,
        remark=f"it settles in {settled[1]} of {len(found.loops)} runs, in pitch and yaw in "
        f"{settled[0]}{why_not([one.spherical.trial for one in found.loops])}",
        detail=f"a run that never settles counts as {longest:g} s; with limits 8° off the pole it "
        f"settles in {settled[2]}{why_not([one.limited.trial for one in found.loops])}",
        figure="pole-loops",
        trap="T4",
        confirmed=ratio > 1.1 or settled[1] < settled[0],
    )


def _settled(found: PoleLoopsFound) -> list[int]:
    """Runs that settled: pitch and yaw, spherical, and spherical with limits."""
    passages = [(one.pitch_yaw, one.spherical, one.limited) for one in found.loops]
    return [sum(one.trial.settled for one in some) for some in zip(*passages, strict=True)]


def _rate_figure(found: PoleLoopsFound) -> Shown:
    settings = found.settings
    curves = [
        curve(LABELS[style], found.degrees, rates, style)
        for style, rates in enumerate((found.pitch_yaw, found.spherical))
    ]
    panel = Panel(
        "angle from θ = 0, or from the home pose of pitch and yaw [°]",
        "largest joint rate demanded [rad/s]",
        curves,
        levels=[("the gate's limit", LIMIT)],
        log_x=True,
        log_y=True,
    )
    caption = (
        f"Joint rates that {settings.speed:g} mm/s of marker 1 across the tool takes in the worst "
        f"direction, {settings.depth:g} mm from the RCM."
    )
    figure = Figure("Joint rates near the pole", [panel])
    return Shown("pole-rates", "(1)-(2)", caption, [], figure)


def _loop_figure(found: PoleLoopsFound) -> Shown:
    numbers: dict[str, Callable[[Passage], float | None]] = {
        f"share of the speed within {np.degrees(NEAR):g}° [1]": lambda one: one.kept,
        "settled after [s]": lambda one: one.trial.settle_time,
    }
    arms = ([one.pitch_yaw for one in found.loops], [one.spherical for one in found.loops])
    panels = [
        Panel("", label, [marks([[of(one) for one in some] for some in arms])], categories=LABELS)
        for label, of in numbers.items()
    ]
    before, after, below = ENDS
    caption = (
        f"Closed loops with k = 2 from {before:g} mm on one side of the pole to {after:g} "
        f"mm on the other, {below:g} mm from the RCM, past it at about {found.settings.aside:g} "
        "mm; the tool hangs down, at θ = 180°, which is the same singularity as θ = 0. One mark "
        "for each seed; runs that did not settle have no time."
    )
    figure = Figure("Past the pole", panels, columns=2)
    return Shown("pole-loops", "(1)-(2)", caption, found.settings.seeds, figure)


EXPERIMENT = Experiment(
    name="coordinates",
    title="Sensitivity: the joints' coordinates",
    about="Pitch and yaw, beside the paper's spherical coordinates, near the pole of the latter.",
    whole=Settings(),
    quick=Settings(seeds=(0,), duration=8.0),
    tasks=tasks,
    chapter=chapter,
)
