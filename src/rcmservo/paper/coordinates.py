"""Experiment `coordinates`: pitch and yaw compared with the paper's spherical coordinates.

Spherical coordinates are singular at θ = 0. The experiment computes the joint rates of a motion
near that pole, and runs closed loops past it.
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
from rcmservo.paper.lab.closed_loop import POINT_NOISE_PX
from rcmservo.paper.lab.evaluation import count_settled, failure_reasons, settle
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, finite, mark_panels, median
from rcmservo.safety.gate import Gate
from rcmservo.sim import RigSettings
from rcmservo.study.report.statistics import format_finite

HANGING_ARM = SphericalRcm(
    JointLimits((0.5 * np.pi, -2.0 * np.pi, 40.0), (1.5 * np.pi, 2.0 * np.pi, 240.0))
)
"""Arm with spherical joints, the pole inside its limits, and the tool hanging down like that of a
pitch and yaw arm."""
LIMITED_ARM = replace(
    HANGING_ARM,
    limits=replace(HANGING_ARM.limits, upper=(float(np.radians(172.0)), 2.0 * np.pi, 240.0)),
)
"""The same arm with limits that exclude 8° about the pole, like the default limits."""
ARMS: dict[str, Kinematics] = {
    "pitch_yaw": PitchYawRcm(),
    "spherical": HANGING_ARM,
    "limited": LIMITED_ARM,
}
COORDINATE_NAMES = {"pitch_yaw": "pitch and yaw", "spherical": "spherical"}
PATH_ENDS_MM = (30.0, 32.0, 100.0)
"""Ends of the path of marker 1 in mm: across the pole on one side and the other, and depth below
the RCM."""
POLE_ANGLE = float(np.radians(5.0))
"""Angle (rad) from the pole within which the speed is measured."""
MAX_ANGLE_RATE = Gate().speed[0]
"""Largest rate (rad/s) of an angle that the gate permits."""


def fixed_settings() -> dict[str, object]:
    return {"arms": ARMS, "scene": PINHOLE, "noise": POINT_NOISE_PX}


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed("loop", partial(loop, settings=settings), range(settings.seeds))


def loop(settings: Settings, seed: int) -> TaskResult:
    """Return the trial of one seed with each arm."""
    return {name: past_pole(arm, settings, seed) for name, arm in ARMS.items()}


def past_pole(arm: Kinematics, settings: Settings, seed: int) -> TaskResult:
    """Return the trial of a closed loop past the pole, with its smallest angle from it (rad).

    ``kept`` is the fraction of the law's speed that the gate permits within `POLE_ANGLE` of the
    pole; None if the tool never came that near.
    """
    start, target = (tuple(float(x) for x in arm.joints(p1)) for p1 in ends(settings, seed))
    laboratory = RigSettings(
        mechanism=arm,
        scene=replace(PINHOLE, start=start, target=target),
        point_noise=POINT_NOISE_PX,
    )
    trial, ticks = settle(seed, laboratory, settings.duration)
    angles = np.array([from_pole(arm, tick) for tick in ticks])
    pairs = zip(ticks, angles, strict=True)
    near = [tick for tick, angle in pairs if tick.state.explored and angle < POLE_ANGLE]
    sent = sum(
        float(arm.jacobian(t.observation.q) @ t.state.command.rates @ t.state.v) for t in near
    )
    demanded = sum(float(tick.state.v @ tick.state.v) for tick in near)
    fraction = sent / demanded if demanded > 0.0 else None
    return {**trial, "nearest": angles.min(), "kept": fraction}


def from_pole(arm: Kinematics, tick: Tick) -> float:
    """Return the angle (rad) between the tool and the pole below the RCM."""
    p1 = arm.position(tick.observation.q)
    return float(np.arctan2(np.hypot(p1[0], p1[1]), -p1[2]))


def ends(settings: Settings, seed: int) -> list[Floats]:
    """Return both ends (3,) in mm of the path of marker 1 past the pole, in a random direction."""
    before, after, below = PATH_ENDS_MM
    turn = np.random.default_rng(seed).uniform(0.2, np.pi - 0.2)
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    return [
        np.array([*(end * along + settings.distance * across), -below]) for end in (before, -after)
    ]


def angles_of(settings: Settings) -> Floats:
    """Return angles (n,) in rad from θ = 0, or from the home pose of pitch and yaw, decreasing."""
    first, last = (float(np.radians(angle)) for angle in settings.angles)
    return np.geomspace(first, last, 400)


def rates(settings: Settings, kinematics: Kinematics, side: float) -> Floats:
    """Return the largest angle rate (rad/s) of a motion across the tool, at the angles `angles_of`.

    The motion is in the worst direction. `side` is the sign of z at the pole.
    """
    across, found = np.array([np.cos(0.7), np.sin(0.7)]), list[float]()
    for t in angles_of(settings):
        p1 = settings.depth * np.array([*(np.sin(t) * across), side * np.cos(t)])
        jacobian = kinematics.jacobian(kinematics.joints(p1))
        found.append(float(settings.speed / np.min(np.linalg.norm(jacobian[:, :2], axis=0))))
    return np.array(found)


def all_rates(settings: Settings) -> dict[str, Floats]:
    """Return the required rates in both coordinates."""
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
        bound=MAX_ANGLE_RATE,
        confirmed=spherical[-1] > 100.0 * spherical[0],
        limit=MAX_ANGLE_RATE,
        nearest=degrees[-1],
        beyond=np.max(degrees[spherical > MAX_ANGLE_RATE], initial=0.0),
        first=spherical[0],
        farthest=degrees[0],
    )
    loops = results.per_seed("loop", seeds)
    fractions = {name: median(finite(column(loops, name, "kept"))) for name in COORDINATE_NAMES}
    yield Measurement(
        "keeps-speed",
        fractions["spherical"],
        seeds,
        confirmed=fractions["spherical"] < 0.9 <= fractions["pitch_yaw"],
        near=np.degrees(POLE_ANGLE),
        kept=format_finite(fractions["pitch_yaw"]),
        nearest=np.degrees(median(column(loops, "spherical", "nearest"))),
    )
    trials = {name: [one[name] for one in loops] for name in ARMS}
    counts = {name: count_settled(some) for name, some in trials.items()}
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
        reasons=failure_reasons(trials["spherical"]),
        limited=failure_reasons(trials["limited"]),
    )
    fastest = demanded["pitch_yaw"].max()
    yield Measurement("other-rate", fastest, bound=MAX_ANGLE_RATE, limit=MAX_ANGLE_RATE)


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    degrees, demanded = np.degrees(angles_of(settings)), all_rates(settings)
    curves = [
        make_curve(label, degrees, demanded[name], style)
        for style, (name, label) in enumerate(COORDINATE_NAMES.items())
    ]
    panel = Panel(
        "angle from θ = 0, or from the home pose of pitch and yaw [°]",
        "largest joint rate [rad/s]",
        curves,
        levels=[("limit of the gate", MAX_ANGLE_RATE)],
        log_x=True,
        log_y=True,
    )
    yield ReportFigure("pole-rates", [], Figure("Joint rates near the pole", [panel]))
    loops = results.per_seed("loop", range(settings.seeds))
    numbers = {
        "kept": f"fraction of the speed within {np.degrees(POLE_ANGLE):g}° [1]",
        "settle_time": "settled after [s]",
    }
    panels = mark_panels(
        numbers,
        lambda key: [column(loops, arm, key) for arm in COORDINATE_NAMES],
        COORDINATE_NAMES.values(),
    )
    figure = Figure("Past the pole", panels, columns=2)
    yield ReportFigure("pole-loops", range(settings.seeds), figure, words={"ends": PATH_ENDS_MM})
