"""Check of eq. (1)-(2): the paper's spherical coordinates, compared with pitch and yaw.

Experiment `coordinates`; the kinematics are in geometry/kinematics.py. Spherical coordinates are
singular at θ = 0. The experiment computes the joint rates of a motion near that pole, and runs
closed loops past it.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from rcmservo.figures.charts import Figure, Panel
from rcmservo.geometry.kinematics import JointLimits, Kinematics, PitchYawRcm, SphericalRcm
from rcmservo.interfaces import Floats
from rcmservo.loop.servo_loop import Tick
from rcmservo.paper.lab.cameras import PINHOLE
from rcmservo.paper.lab.evaluation import count_settled, list_failures, settle
from rcmservo.paper.lab.paper_settings import POINT_NOISE_PX
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, curve_per_label, finite, mark_panels, median
from rcmservo.safety.gate import Gate
from rcmservo.sim import RigSettings
from rcmservo.study.report.statistics import format_finite

LOWER_LIMITS, UPPER_LIMITS = (0.5 * np.pi, -2.0 * np.pi, 40.0), (1.5 * np.pi, 2.0 * np.pi, 240.0)
HANGING_ARM = SphericalRcm(JointLimits(LOWER_LIMITS, UPPER_LIMITS))
"""Arm with spherical joints, the pole inside its limits, and the tool hanging down like that of a
pitch and yaw arm."""
LIMITED_ARM = SphericalRcm(JointLimits(LOWER_LIMITS, (float(np.radians(172.0)), *UPPER_LIMITS[1:])))
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
MOTION_DIRECTION_RAD = 0.7
"""Direction of the motion away from the pole, about the z axis."""


def tasks(settings: Settings) -> list[Task]:
    return Task.per_seed("loop", partial(run_loops, settings=settings), range(settings.seeds))


def run_loops(settings: Settings, seed: int) -> TaskResult:
    """Return the trial of one seed with each arm."""
    return {name: servo_past_pole(arm, settings, seed) for name, arm in ARMS.items()}


def servo_past_pole(arm: Kinematics, settings: Settings, seed: int) -> TaskResult:
    """Return the trial of a closed loop past the pole, with its smallest angle from it (rad).

    ``kept`` is the fraction of the controller's speed that the gate permits within `POLE_ANGLE` of
    the pole; None if the tool never came that near.
    """
    ends = draw_path_ends(settings, seed)
    start, target = (tuple(float(x) for x in arm.joints(p1)) for p1 in ends)
    scene = replace(PINHOLE, start=start, target=target)
    laboratory = RigSettings(mechanism=arm, scene=scene, point_noise=POINT_NOISE_PX)
    trial, ticks = settle(seed, laboratory, settings.duration)
    angles = np.array([angle_from_pole(arm, tick) for tick in ticks])
    pairs = zip(ticks, angles, strict=True)
    near = [tick for tick, angle in pairs if tick.state.explored and angle < POLE_ANGLE]
    sent = sum(
        float(arm.jacobian(t.observation.q) @ t.state.command.rates @ t.state.v) for t in near
    )
    demanded = sum(float(tick.state.v @ tick.state.v) for tick in near)
    fraction = sent / demanded if demanded > 0.0 else None
    return {**trial, "nearest": angles.min(), "kept": fraction}


def angle_from_pole(arm: Kinematics, tick: Tick) -> float:
    """Return the angle (rad) between the tool and the pole below the RCM."""
    p1 = arm.position(tick.observation.q)
    return float(np.arctan2(np.hypot(p1[0], p1[1]), -p1[2]))


def draw_path_ends(settings: Settings, seed: int) -> list[Floats]:
    """Return both ends (3,) in mm of the path of marker 1 past the pole, in a random direction."""
    before, after, below = PATH_ENDS_MM
    turn = np.random.default_rng(seed).uniform(0.2, np.pi - 0.2)
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    offset = settings.distance * across
    return [np.array([*(end * along + offset), -below]) for end in (before, -after)]


def list_angles(settings: Settings) -> Floats:
    """Return angles (n,) in rad from θ = 0, or from the home pose of pitch and yaw, decreasing."""
    first, last = (float(np.radians(angle)) for angle in settings.angles)
    return np.geomspace(first, last, 400)


def compute_rates(settings: Settings) -> dict[str, Floats]:
    """Return the largest angle rate (rad/s) of a motion across the tool in both coordinates.

    The rates (n,) are those at the angles `list_angles`, with the motion in the worst direction.
    """
    direction = np.array([np.cos(MOTION_DIRECTION_RAD), np.sin(MOTION_DIRECTION_RAD)])
    rates: dict[str, list[float]] = {name: [] for name in COORDINATE_NAMES}
    sides = {"pitch_yaw": (PitchYawRcm(), -1.0), "spherical": (SphericalRcm(), 1.0)}
    for name, (kinematics, side) in sides.items():  # side: sign of z at the pole
        for t in list_angles(settings):
            p1 = settings.depth * np.array([*(np.sin(t) * direction), side * np.cos(t)])
            jacobian = kinematics.jacobian(kinematics.joints(p1))
            slowest = np.min(np.linalg.norm(jacobian[:, :2], axis=0))
            rates[name].append(float(settings.speed / slowest))
    return {name: np.array(values) for name, values in rates.items()}


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds, degrees = range(settings.seeds), np.degrees(list_angles(settings))
    rates = compute_rates(settings)
    spherical = rates["spherical"]
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
    pitch_yaw, past_pole = (
        median(finite(column(loops, name, "kept"))) for name in COORDINATE_NAMES
    )
    nearest = np.degrees(median(column(loops, "spherical", "nearest")))
    texts = Texts(near=np.degrees(POLE_ANGLE), kept=format_finite(pitch_yaw), nearest=nearest)
    is_slowed = past_pole < 0.9 <= pitch_yaw
    yield Measurement("keeps-speed", past_pole, seeds, confirmed=is_slowed, **texts)
    trials = {name: [loop[name] for loop in loops] for name in ARMS}
    counts = {name: count_settled(trials[name]) for name in ARMS}
    times = {
        name: np.nan_to_num(column(trials[name], "settle_time"), nan=settings.duration)
        for name in ARMS
    }
    ratio = median(times["spherical"] / times["pitch_yaw"])
    is_worse = ratio > 1.1 or counts["spherical"] < counts["pitch_yaw"]
    reasons, limited = (list_failures(trials[name]) for name in ("spherical", "limited"))
    texts = Texts(counts=counts, loops=len(loops), reasons=reasons, limited=limited)
    yield Measurement("settles-as-soon", ratio, seeds, confirmed=is_worse, **texts)
    fastest = rates["pitch_yaw"].max()
    yield Measurement("other-rate", fastest, bound=MAX_ANGLE_RATE, limit=MAX_ANGLE_RATE)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    degrees, rates = np.degrees(list_angles(settings)), compute_rates(settings)
    panel = Panel(
        "angle from θ = 0, or from the home pose of pitch and yaw [°]",
        "largest joint rate [rad/s]",
        curve_per_label(COORDINATE_NAMES, lambda name: (degrees, rates[name])),
        levels=[("limit of the gate", MAX_ANGLE_RATE)],
        log_x=True,
        log_y=True,
    )
    yield PaperFigure("pole-rates", [], Figure("Joint rates near the pole", [panel]))
    loops = results.per_seed("loop", range(settings.seeds))
    labels = {
        "kept": f"fraction of the speed within {np.degrees(POLE_ANGLE):g}° [1]",
        "settle_time": "settled after [s]",
    }

    def list_values(name: str) -> list[Floats]:
        return [column(loops, arm, name) for arm in COORDINATE_NAMES]

    panels = mark_panels(labels, list_values, COORDINATE_NAMES.values())
    figure, texts = Figure("Past the pole", panels, columns=2), {"ends": PATH_ENDS_MM}
    yield PaperFigure("pole-loops", range(settings.seeds), figure, texts=texts)
