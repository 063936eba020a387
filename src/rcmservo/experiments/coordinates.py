"""What the joints' coordinates cost: pitch and yaw, or the paper's spherical ones, which are
singular at θ = 0.

Once as the joint rates that a motion near the pole demands, and once in closed loops that pass the
pole.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.cameras import PINHOLE
from rcmservo.experiments.harness.claims import Chapter, Claim, Experiment, Results, Shown, Task
from rcmservo.experiments.harness.closed_loop import NOISE
from rcmservo.experiments.harness.settling import settle, why_not
from rcmservo.experiments.harness.ways import Rows, marks, middle, middles, numbers
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.gate import Gate
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick
from rcmservo.method.kinematics import JointLimits, Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.sim import Rig, RigSettings

POLE = {"spherical": SphericalRcm(), "pitch-yaw": PitchYawRcm()}
HANGING = SphericalRcm(
    JointLimits((0.5 * np.pi, -2.0 * np.pi, 40.0), (1.5 * np.pi, 2.0 * np.pi, 240.0))
)
"""Spherical joints with the pole inside their limits, and the tool hanging down as a pitch and yaw
arm's does."""

KEPT = replace(
    HANGING, limits=replace(HANGING.limits, upper=(float(np.radians(172.0)), 2.0 * np.pi, 240.0))
)
"""The same with limits that leave 8° about the pole out, as the default's do."""

ARMS: Mapping[str, Kinematics] = {"pitch-yaw": PitchYawRcm(), "spherical": HANGING, "kept": KEPT}
LABELS = {"pitch-yaw": "pitch and yaw", "spherical": "spherical"}
ENDS = (30.0, 32.0, 100.0)
"""mm of marker 1: across the pole on either side, and below the RCM."""

NEAR = float(np.radians(5.0))
"""Angle from the pole within which the speed is judged."""


@dataclass(frozen=True)
class Settings:
    """``angles`` rad between tool and pole, greatest and least, at ``depth`` mm and ``speed`` mm/s;
    ``seeds`` of loops of ``duration`` s whose straight way passes the pole at ``aside`` mm."""

    angles: tuple[float, float] = (float(np.radians(30.0)), float(np.radians(0.1)))
    depth: float = 100.0
    speed: float = 10.0
    seeds: tuple[int, ...] = tuple(range(8))
    aside: float = 1.0
    duration: float = 20.0


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(f"loop-{seed}", loop, {"settings": settings, "seed": seed}) for seed in settings.seeds
    ]


def loop(folder: Path, settings: Settings, seed: int) -> dict[str, Any]:
    """The same closed loop past the pole with every arm: how near it came, how much of its speed it
    kept, and when it settled."""
    del folder
    return {name: past_pole(arm, settings, seed) for name, arm in ARMS.items()}


def past_pole(arm: Kinematics, settings: Settings, seed: int) -> dict[str, Any]:
    """One loop from one side of the pole to the other; ``kept`` is the share that the gate left of
    the law's speed."""
    start, target = (tuple(float(x) for x in arm.joints(p1)) for p1 in places(settings, seed))
    laboratory = RigSettings(
        mechanism=arm, scene=replace(PINHOLE, start=start, target=target), point_noise=NOISE
    )
    angles: list[float] = []
    speeds: list[tuple[float, float]] = []

    def watch(rig: Rig, tick: Tick) -> None:
        p1 = rig.truth.markers(rig.clock.now())[0]
        angles.append(float(np.arctan2(np.hypot(p1[0], p1[1]), -p1[2])))
        if tick.state.explored and angles[-1] < NEAR:
            sent = arm.jacobian(tick.seen.q) @ tick.state.command.rates
            speeds.append((float(sent @ tick.state.v), float(tick.state.v @ tick.state.v)))

    values = settle(seed, laboratory, settings.duration, watch)
    sent, wanted = np.sum(speeds, axis=0) if speeds else (0.0, 0.0)
    return {
        **values,
        "nearest": min(angles),
        "kept": float(sent / wanted) if wanted > 0.0 else None,
    }


def places(settings: Settings, seed: int) -> list[Floats]:
    """Both ends (3,) mm of marker 1's way past the pole, in a drawn direction."""
    before, after, below = ENDS
    turn = np.random.default_rng(seed).uniform(0.2, np.pi - 0.2)
    along, beside = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    return [
        np.array([*(end * along + settings.aside * beside), -below]) for end in (before, -after)
    ]


def rates(settings: Settings) -> dict[str, Floats]:
    """What both coordinates demand at angles from the pole of either, rad/s, and the angles."""
    angles = np.geomspace(*settings.angles, 400)
    across = np.array([np.cos(0.7), np.sin(0.7)])
    found: dict[str, Floats] = {"angles": angles}
    for name, kinematics in POLE.items():
        side = -1.0 if name == "pitch-yaw" else 1.0
        points = [
            settings.depth * np.array([*(np.sin(t) * across), side * np.cos(t)]) for t in angles
        ]
        found[name] = np.array([demanded(kinematics, p1, settings.speed) for p1 in points])
    return found


def demanded(kinematics: Kinematics, p1: Floats, speed: float) -> float:
    """Largest angle rate rad/s that moving marker 1 with `speed` mm/s across the tool may take at
    p1 (3,) mm."""
    jacobian = kinematics.jacobian(kinematics.joints(p1))
    return float(speed / np.min(np.linalg.norm(jacobian[:, :2], axis=0)))


def chapter(settings: Settings, results: Results) -> Chapter:
    limit, found = Gate().speed[0], rates(settings)
    loops = [results[f"loop-{seed}"].values for seed in settings.seeds]
    return Chapter(
        [*_rate_claims(settings, found, limit), *_loop_claims(settings, loops)],
        [_rate_figure(settings, found, limit), _loop_figure(settings, loops)],
    )


def _rate_claims(settings: Settings, found: dict[str, Floats], limit: float) -> list[Claim]:
    degrees, spherical = np.degrees(found["angles"]), found["spherical"]
    first, last = float(spherical[0]), float(spherical[-1])
    beyond = float(np.max(degrees[spherical > limit], initial=0.0))
    return [
        Claim(
            f"{settings.speed:g} mm/s across the tool, {settings.depth:g} mm from the RCM, stays "
            f"within {limit:g} "
            f"rad/s in the paper's coordinates down to θ = {degrees[-1]:.1f}°",
            "(1)-(2)",
            last,
            "rad/s",
            "<=",
            limit,
            [],
            remark=f"they are singular at θ = 0, where φ turns without end: beyond {limit:g} "
            f"rad/s below {beyond:.1f}°",
            detail=f"{first:.2g} rad/s at {degrees[0]:.0f}°",
            figure="pole-rates",
            trap="T4",
            confirmed=last > 100.0 * first,
        ),
        Claim(
            f"{settings.speed:g} mm/s across the tool stays within {limit:g} rad/s in pitch and "
            f"yaw all the way",
            "ours",
            float(np.max(found["pitch-yaw"])),
            "rad/s",
            "<=",
            limit,
            [],
            figure="pole-rates",
        ),
    ]


def _loop_claims(settings: Settings, loops: Rows) -> list[Claim]:
    kept = middles(loops, ARMS, "kept")
    nearest = np.degrees(middle(numbers(loops, "spherical", "nearest")))
    settled = {name: sum(one[name]["settled"] for one in loops) for name in ARMS}
    unsettled = {name: why_not([one[name] for one in loops]) for name in ARMS}
    ratio = middle(numbers(loops, "spherical", "time") / numbers(loops, "pitch-yaw", "time"))
    return [
        Claim(
            "a servo run past the pole keeps the speed that the law asks for, in the paper's "
            "coordinates: share of it "
            f"within {np.degrees(NEAR):g}° of the pole",
            "(1)-(2), (31)",
            kept["spherical"],
            "",
            ">=",
            0.9,
            settings.seeds,
            remark=f"the gate scales the speed down while φ turns; pitch and yaw keep "
            f"{kept['pitch-yaw']:.2f} of it",
            detail=f"nearest {nearest:.1f}° from the pole (median)",
            figure="pole-loops",
            trap="T4",
            confirmed=kept["spherical"] < 0.9 <= kept["pitch-yaw"],
        ),
        Claim(
            "a servo run past the pole settles as soon in the paper's coordinates as in pitch "
            "and yaw: time over time "
            "where both settle",
            "(1)-(2), (31)",
            ratio,
            "",
            "<=",
            1.1,
            settings.seeds,
            remark=f"it settles in {settled['spherical']} of {len(loops)} runs, in pitch and yaw "
            f"in "
            f"{settled['pitch-yaw']}{unsettled['spherical']}",
            detail=f"with limits 8° off the pole it settles in "
            f"{settled['kept']}{unsettled['kept']}",
            figure="pole-loops",
            trap="T4",
            confirmed=ratio > 1.1 or settled["spherical"] < settled["pitch-yaw"],
        ),
    ]


def _rate_figure(settings: Settings, found: dict[str, Floats], limit: float) -> Shown:
    degrees = np.degrees(found["angles"])
    curves = [curve(LABELS[name], degrees, found[name], style) for style, name in enumerate(POLE)]
    panel = Panel(
        "angle from θ = 0, or from the home pose of pitch and yaw [°]",
        "largest joint rate demanded [rad/s]",
        curves,
        levels=[("the gate's limit", limit)],
        log_x=True,
        log_y=True,
    )
    caption = (
        f"Joint rates that {settings.speed:g} mm/s of marker 1 across the tool takes in the "
        f"worst direction, "
        f"{settings.depth:g} mm from the RCM."
    )
    return Shown("pole-rates", "(1)-(2)", caption, [], Figure("Joint rates near the pole", [panel]))


def _loop_figure(settings: Settings, loops: Rows) -> Shown:
    words = {
        "kept": f"share of the speed within {np.degrees(NEAR):g}° [1]",
        "time": "settled after [s]",
    }
    panels = [
        Panel("", label, [marks(loops, LABELS, key)], categories=list(LABELS.values()))
        for key, label in words.items()
    ]
    before, after, below = ENDS
    caption = (
        f"Closed loops with default gains from {before:g} mm on one side of the pole to "
        f"{after:g} mm on the other, "
        f"{below:g} mm from the RCM, past it at about {settings.aside:g} mm; the tool hangs "
        f"down, at θ = 180°, which "
        "is the same singularity as θ = 0. One mark for each seed; runs that did not settle have "
        "no time."
    )
    return Shown(
        "pole-loops", "(1)-(2)", caption, settings.seeds, Figure("Past the pole", panels, columns=2)
    )


EXPERIMENT = Experiment(
    name="coordinates",
    title="Sensitivity: the joints' coordinates",
    about="Pitch and yaw, beside the paper's spherical coordinates, near the pole of the latter.",
    whole=Settings(),
    quick=Settings(seeds=(0,), duration=8.0),
    tasks=tasks,
    chapter=chapter,
)
