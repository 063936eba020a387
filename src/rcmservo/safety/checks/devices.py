"""Detectors of faults of arm, loop, record and frames.

Every check is written so that NaN trips it.
"""

from typing import cast

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, reachable
from rcmservo.interfaces import Dropped, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite
from rcmservo.safety.checks.facts import DetailFacts, TickFacts, has_frame
from rcmservo.safety.thresholds import Thresholds

NOT_DROPPED, NOT_NEW, CLOCK, DAMAGED = cast(list[Dropped], list(map(int, Dropped)))
"""Members of `Dropped` in compiled functions."""

NO_REASON = cast(Dropped, -1)
"""None of them."""

UNITS = ("rad", "rad", "mm")


@compiled
def joints_are_not_finite(c: TickFacts) -> bool:
    """Detect joint positions that are not finite."""
    return not all_finite(c.seen.q)


@compiled
def drive_went_off(c: TickFacts) -> bool:
    """Detect a drive that is off but should be on."""
    return c.drive_requested and not c.seen.enabled


@compiled
def arm_is_silent(c: TickFacts) -> bool:
    """Detect joint positions that are too old."""
    return not abs(c.seen.now - c.seen.q_time) <= c.thresholds.silence * 1e9


@compiled
def joint_is_beyond_limit(c: TickFacts) -> bool:
    """Detect a joint beyond its limit and slack."""
    return not reachable(c.rcm, c.seen.q, c.thresholds.slack)


@compiled
def joints_do_not_follow(c: TickFacts) -> bool:
    """Detect a following error."""
    return deviates(c.seen.q, c.watch.reached, c.thresholds)


@compiled
def joints_creep(c: TickFacts) -> bool:
    """Detect motion while nothing is commanded."""
    return all_finite(c.watch.rest) and deviates(c.seen.q, c.watch.rest, c.thresholds)


@compiled
def deviates(q: Floats, expected: Floats, t: Thresholds) -> bool:
    """Return True if a joint of q (3,) is further than ``following`` from where it is expected."""
    near = True
    for i in range(3):
        near = near and abs(q[i] - expected[i]) <= t.following[i]
    return not near


@compiled
def clock_stood(c: TickFacts) -> bool:
    """Detect a clock that stood still or went back."""
    return not c.watch.gap > 0


@compiled
def loop_overran(c: TickFacts) -> bool:
    """Detect late ticks in a row, or one that is much too late."""
    t, late = c.thresholds, c.watch.gap - c.period
    return c.watch.late >= t.late_ticks or not late <= t.overrun * 1e9


@compiled
def tick_came_late(c: TickFacts) -> bool:
    """Detect a late tick."""
    return c.watch.late > 0


@compiled
def recording_failed(c: TickFacts) -> bool:
    """Detect a record that can no longer be written."""
    return not c.seen.recorded


@compiled
def joints_at_exposure_are_unknown(c: TickFacts) -> bool:
    """Detect joints at the exposure that are unknown or beyond their limits."""
    return has_frame(c) and not reachable(c.rcm, c.seen.q_exposure, c.thresholds.slack)


@compiled
def frames_come_late(c: TickFacts) -> bool:
    """Detect too long a time from exposure to tick."""
    return has_frame(c) and not c.watch.latency <= c.thresholds.latency * 1e9


@compiled
def frame_is_old(c: TickFacts) -> bool:
    """Detect a newest frame that is older than usual."""
    return has_frame(c) and not periods_since(c, c.seen.arrival) <= c.thresholds.stale_slow


@compiled
def frames_stopped(c: TickFacts) -> bool:
    """Detect that no frame comes, or that a paused run has seen none."""
    return missing_reason(c) == NOT_DROPPED or (c.paused and not has_frame(c))


@compiled
def frames_are_damaged(c: TickFacts) -> bool:
    """Detect that only damaged frames come."""
    return missing_reason(c) == DAMAGED


@compiled
def frames_are_not_new(c: TickFacts) -> bool:
    """Detect that frames come repeated or out of order."""
    return missing_reason(c) == NOT_NEW or c.seen.frame < c.watch.frame


@compiled
def frame_times_are_invalid(c: TickFacts) -> bool:
    """Detect invalid times: of frames that are not used, or that keep coming and are always
    old.
    """
    return missing_reason(c) == CLOCK or (is_missing(c) and keeps_coming(c))


@compiled
def missing_reason(c: TickFacts) -> Dropped:
    """Return why the last frame offered was not used, if no frame comes; else NO_REASON."""
    return c.seen.dropped if is_missing(c) and not keeps_coming(c) else NO_REASON


@compiled
def is_missing(c: TickFacts) -> bool:
    """Return True if the newest frame arrived too long ago."""
    return has_frame(c) and not periods_since(c, c.seen.arrival) <= c.thresholds.stale_hold


@compiled
def keeps_coming(c: TickFacts) -> bool:
    """Return True if the newest frame was first used a short time ago."""
    return periods_since(c, c.watch.taken) <= c.thresholds.stale_slow


@compiled
def periods_since(c: TickFacts, time: int) -> float:
    """Return how many frame periods have passed since a time in ns."""
    period = c.watch.period if c.watch.period != 0.0 else 1e9 * c.thresholds.first_period
    return (c.seen.now - time) / period


def describe_not_finite(f: DetailFacts) -> str:
    """Name the joints that are not finite."""
    q = f.seen.q
    return "; ".join(_joint(f.mechanism, i, q) for i in range(3) if not np.isfinite(q[i]))


def describe_limits(f: DetailFacts) -> str:
    """Name the joints beyond their limits."""
    lower, upper = f.mechanism.limits.arrays
    slack, q = f.thresholds.slack * (upper - lower), f.seen.q
    parts = [
        f"{_joint(f.mechanism, i, q)}, its limits are {lower[i]:.4g} and {upper[i]:.4g}"
        for i in range(3)
        if not lower[i] - slack[i] <= q[i] <= upper[i] + slack[i]
    ]
    return "; ".join(parts)


def describe_following(f: DetailFacts) -> str:
    """Name the joints with a following error."""
    return _deviations(f, f.watch.reached, "should be")


def describe_creeping(f: DetailFacts) -> str:
    """Name the joints that move while nothing is commanded."""
    return _deviations(f, f.watch.rest, "at rest it should stay")


def _deviations(f: DetailFacts, expected: Floats, verb: str) -> str:
    """Name the joints that are further than ``following`` from where they are expected."""
    q, following = f.seen.q, f.thresholds.following
    parts = [
        f"{_joint(f.mechanism, i, q)}, and {verb} within {following[i]:g} of {expected[i]:.4g}"
        for i in range(3)
        if not abs(q[i] - expected[i]) <= following[i]
    ]
    return "; ".join(parts)


def _joint(mechanism: Kinematics, i: int, q: Floats) -> str:
    return f"joint {i + 1} ({mechanism.joint_names[i]}) is at {q[i]:.4g} {UNITS[i]}"
