"""What a person should know beside a cause, in words."""

from collections.abc import Callable

import numpy as np

from rcmservo.guard.causes import Cause
from rcmservo.guard.thresholds import Thresholds
from rcmservo.guard.watch import Watch
from rcmservo.interfaces import Floats, Observation
from rcmservo.method.kinematics import Kinematics

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
