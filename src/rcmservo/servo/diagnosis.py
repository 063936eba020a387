"""What a cause means for what was learnt, what is wrong while exploring, and details in words."""

from collections.abc import Callable

import numpy as np

from rcmservo.guard.causes import Cause
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Watch
from rcmservo.interfaces import Floats, Observation
from rcmservo.method.exploration import Exploration
from rcmservo.method.kinematics import Kinematics
from rcmservo.method.tool import Tool
from rcmservo.servo.state import Learnt

UNLEARNT = {
    Cause.DIVERGED,
    Cause.NOT_EXPLORED,
    Cause.ESTIMATE_LARGE,
    Cause.ESTIMATOR_FAILED,
    Cause.ESTIMATE_NOT_FINITE,
    Cause.NOT_FINITE,
}
"""Causes of a pause or fault after which the estimate is learnt anew, beside a moved camera.

After the others it is kept, and with it the newest frame believed, so that a camera moved meanwhile
is noticed.
"""


def spoils(cause: Cause, explored: bool) -> tuple[bool, bool]:
    """Whether a cause means that the camera was moved, and whether it spoils the estimate.

    Without an estimate nobody can tell one false marker from a camera that was moved: then it
    counts as that. Nor can anybody tell whether markers that changed places are wrong now or were
    before.
    """
    moved = cause is Cause.CAMERA_MOVED or (cause is Cause.SURPRISED and not explored)
    swapped = cause is Cause.SWAPPED and not explored
    return moved, moved or swapped or cause in UNLEARNT


def tour_faults(learnt: Learnt, exploration: Exploration, tool: Tool, now: int) -> int:
    """What is wrong while exploring, as a set of causes."""
    if learnt.no_room:
        return Cause.NO_ROOM.bit
    if learnt.tour is None or not exploration.overdue(learnt.tour, now):
        return 0
    return (Cause.SWAPPED if out_of_order(learnt, tool) else Cause.NOT_EXPLORED).bit


def out_of_order(learnt: Learnt, tool: Tool) -> bool:
    """Whether marker 1 stands beyond marker 2 as seen from o_c, though its tool has it nearer the
    RCM."""
    seen = learnt.estimate
    first, second = seen.points - seen.o_c
    beyond = float(first @ second) > float(second @ second)
    return beyond and float(seen.p1 @ (tool.second_marker(seen.p1) - seen.p1)) > 0.0


UNITS = ("rad", "rad", "mm")


def detail(
    cause: Cause, watch: Watch, seen: Observation, mechanism: Kinematics, limits: Thresholds
) -> str:
    """Which joint it is, its value and its limit; empty where a cause has no such detail."""
    tell = DETAILS.get(cause)
    return "" if tell is None else tell(watch, seen, mechanism, limits)


def _beyond(watch: Watch, seen: Observation, mechanism: Kinematics, limits: Thresholds) -> str:
    del watch
    lower, upper = mechanism.limits.arrays
    slack = limits.slack * (upper - lower)
    parts = [
        f"{_joint(mechanism, i, seen.q)}, its limits are {lower[i]:.4g} and {upper[i]:.4g}"
        for i in range(3)
        if not lower[i] - slack[i] <= seen.q[i] <= upper[i] + slack[i]
    ]
    return "; ".join(parts)


def _not_following(
    watch: Watch, seen: Observation, mechanism: Kinematics, limits: Thresholds
) -> str:
    return _astray(seen.q, watch.reached, mechanism, limits, "should be")


def _creeps(watch: Watch, seen: Observation, mechanism: Kinematics, limits: Thresholds) -> str:
    return _astray(seen.q, watch.rest, mechanism, limits, "at rest it should stay")


def _astray(q: Floats, places: Floats, mechanism: Kinematics, limits: Thresholds, why: str) -> str:
    """The joints that are further than ``following`` from their `places` (3,)."""
    parts = [
        f"{_joint(mechanism, i, q)}, and {why} within {limits.following[i]:g} of {places[i]:.4g}"
        for i in range(3)
        if not abs(q[i] - places[i]) <= limits.following[i]
    ]
    return "; ".join(parts)


def _not_finite(watch: Watch, seen: Observation, mechanism: Kinematics, limits: Thresholds) -> str:
    del watch, limits
    return "; ".join(_joint(mechanism, i, seen.q) for i in range(3) if not np.isfinite(seen.q[i]))


def _joint(mechanism: Kinematics, i: int, q: Floats) -> str:
    return f"joint {i + 1} ({mechanism.joint_names[i]}) is at {q[i]:.4g} {UNITS[i]}"


DETAILS: dict[Cause, Callable[[Watch, Observation, Kinematics, Thresholds], str]] = {
    Cause.BEYOND_LIMIT: _beyond,
    Cause.NOT_FOLLOWING: _not_following,
    Cause.CREEPS: _creeps,
    Cause.JOINTS_NOT_FINITE: _not_finite,
}
