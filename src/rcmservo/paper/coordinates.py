"""Sensitivity to the joints' coordinates: pitch and yaw, or the paper's spherical ones.

The latter are singular at θ = 0. Once as the joint rates that a motion near that pole demands, and
once in closed loops that pass it.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.kinematics import JointLimits, Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick
from rcmservo.paper.lab.cameras import PINHOLE
from rcmservo.paper.lab.closed_loop import NOISE
from rcmservo.paper.lab.witness import reasons, settle, settled
from rcmservo.paper.plan import Drawn, Found, Measurement, Results, Settings, Task
from rcmservo.paper.statistics import column, finite, mark_panels, median
from rcmservo.safety.gate import Gate
from rcmservo.sim import RigSettings
from rcmservo.study.report.statistics import dashed

HANGING = SphericalRcm(
    JointLimits((0.5 * np.pi, -2.0 * np.pi, 40.0), (1.5 * np.pi, 2.0 * np.pi, 240.0))
)
"""Spherical joints with the pole inside their limits, and the tool hanging down as a pitch and yaw
arm's does."""
LIMITED = replace(
    HANGING, limits=replace(HANGING.limits, upper=(float(np.radians(172.0)), 2.0 * np.pi, 240.0))
)
"""The same with limits that exclude 8° about the pole, as the default's do."""
ARMS: dict[str, Kinematics] = {"pitch_yaw": PitchYawRcm(), "spherical": HANGING, "limited": LIMITED}
FIXED = {"arms": ARMS, "scene": PINHOLE, "noise": NOISE}
LABELS = {"pitch_yaw": "pitch and yaw", "spherical": "spherical"}
ENDS = (30.0, 32.0, 100.0)
"""mm of marker 1: across the pole on either side, and below the RCM."""
NEAR = float(np.radians(5.0))
"""Angle from the pole within which the speed is judged."""
LIMIT = Gate().speed[0]
"""rad/s of an angle that the gate permits."""


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed("loop", partial(loop, settings=settings), range(settings.seeds))


def loop(settings: Settings, seed: int) -> Found:
    """Return the same closed loop past the pole with every arm."""
    return {name: past_pole(arm, settings, seed) for name, arm in ARMS.items()}


def past_pole(arm: Kinematics, settings: Settings, seed: int) -> Found:
    """Return the trial of a loop to the other side of the pole, and how near it came (rad).

    ``kept`` is the fraction that the gate left of the law's speed near the pole; None if it never
    came near.
    """
    start, target = (tuple(float(x) for x in arm.joints(p1)) for p1 in ends(settings, seed))
    laboratory = RigSettings(
        mechanism=arm, scene=replace(PINHOLE, start=start, target=target), point_noise=NOISE
    )
    trial, ticks = settle(seed, laboratory, settings.duration)
    angles = np.array([from_pole(arm, tick) for tick in ticks])
    pairs = zip(ticks, angles, strict=True)
    near = [tick for tick, angle in pairs if tick.state.explored and angle < NEAR]
    sent = sum(float(arm.jacobian(t.seen.q) @ t.state.command.rates @ t.state.v) for t in near)
    demanded = sum(float(tick.state.v @ tick.state.v) for tick in near)
    kept = sent / demanded if demanded > 0.0 else None
    return {**trial, "nearest": angles.min(), "kept": kept}


def from_pole(arm: Kinematics, tick: Tick) -> float:
    """Return the angle rad between the tool and the pole below."""
    p1 = arm.position(tick.seen.q)
    return float(np.arctan2(np.hypot(p1[0], p1[1]), -p1[2]))


def ends(settings: Settings, seed: int) -> list[Floats]:
    """Return both ends (3,) mm of marker 1's way past the pole, in a drawn direction."""
    before, after, below = ENDS
    turn = np.random.default_rng(seed).uniform(0.2, np.pi - 0.2)
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    return [
        np.array([*(end * along + settings.distance * across), -below]) for end in (before, -after)
    ]


def angles_of(settings: Settings) -> Floats:
    """Return angles (n,) rad from θ = 0, or from the home pose of pitch and yaw; greatest first."""
    first, last = (float(np.radians(angle)) for angle in settings.angles)
    return np.geomspace(first, last, 400)


def rates(settings: Settings, kinematics: Kinematics, side: float) -> Floats:
    """Return the largest angle rate (rad/s) that a motion across the tool may take, at `angles_of`.

    The pole lies on this side of z; the motion is in the worst direction.
    """
    across, found = np.array([np.cos(0.7), np.sin(0.7)]), list[float]()
    for t in angles_of(settings):
        p1 = settings.depth * np.array([*(np.sin(t) * across), side * np.cos(t)])
        jacobian = kinematics.jacobian(kinematics.joints(p1))
        found.append(float(settings.speed / np.min(np.linalg.norm(jacobian[:, :2], axis=0))))
    return np.array(found)


def all_rates(settings: Settings) -> dict[str, Floats]:
    """Return the rates demanded in both coordinates."""
    return {
        "pitch_yaw": rates(settings, PitchYawRcm(), -1.0),
        "spherical": rates(settings, SphericalRcm(), 1.0),
    }


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds, degrees, demanded = (
        range(settings.seeds),
        np.degrees(angles_of(settings)),
        all_rates(settings),
    )
    spherical = demanded["spherical"]
    yield Measurement(
        "spherical-rate",
        spherical[-1],
        bound=LIMIT,
        confirmed=spherical[-1] > 100.0 * spherical[0],
        limit=LIMIT,
        nearest=degrees[-1],
        beyond=np.max(degrees[spherical > LIMIT], initial=0.0),
        first=spherical[0],
        farthest=degrees[0],
    )
    loops = results.per_seed("loop", seeds)
    kept = {name: median(finite(column(loops, name, "kept"))) for name in LABELS}
    yield Measurement(
        "keeps-speed",
        kept["spherical"],
        seeds,
        confirmed=kept["spherical"] < 0.9 <= kept["pitch_yaw"],
        near=np.degrees(NEAR),
        kept=dashed(kept["pitch_yaw"]),
        nearest=np.degrees(median(column(loops, "spherical", "nearest"))),
    )
    trials = {name: [one[name] for one in loops] for name in ARMS}
    counts = {name: settled(some) for name, some in trials.items()}
    times = {
        name: np.nan_to_num(column(some, "settle_time"), nan=settings.duration)
        for name, some in trials.items()
    }
    ratio = median(times["spherical"] / times["pitch_yaw"])
    yield Measurement(
        "settles-as-soon",
        ratio,
        seeds,
        confirmed=ratio > 1.1 or counts["spherical"] < counts["pitch_yaw"],
        counts=counts,
        loops=len(loops),
        reasons=reasons(trials["spherical"]),
        limited=reasons(trials["limited"]),
    )
    yield Measurement("other-rate", demanded["pitch_yaw"].max(), bound=LIMIT, limit=LIMIT)


def draw(settings: Settings, results: Results) -> Iterator[Drawn]:
    degrees, demanded = np.degrees(angles_of(settings)), all_rates(settings)
    curves = [
        make_curve(label, degrees, demanded[name], style)
        for style, (name, label) in enumerate(LABELS.items())
    ]
    panel = Panel(
        "angle from θ = 0, or from the home pose of pitch and yaw [°]",
        "largest joint rate demanded [rad/s]",
        curves,
        levels=[("the gate's limit", LIMIT)],
        log_x=True,
        log_y=True,
    )
    yield Drawn("pole-rates", [], Figure("Joint rates near the pole", [panel]))
    loops = results.per_seed("loop", range(settings.seeds))
    numbers = {
        "kept": f"share of the speed within {np.degrees(NEAR):g}° [1]",
        "settle_time": "settled after [s]",
    }
    panels = mark_panels(
        numbers, lambda key: [column(loops, arm, key) for arm in LABELS], LABELS.values()
    )
    figure = Figure("Past the pole", panels, columns=2)
    yield Drawn("pole-loops", range(settings.seeds), figure, words={"ends": ENDS})
