"""Detectors of faults of the arm, the loop, the record and the frames.

Every comparison is written so that NaN triggers the cause.
"""

from typing import cast

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, is_within_limits
from rcmservo.interfaces import DropReason, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite
from rcmservo.safety.checks.facts import DetailFacts, TickFacts, has_frame
from rcmservo.safety.thresholds import Thresholds

NOT_DROPPED, NOT_NEW, INVALID_TIME, DAMAGED = cast(list[DropReason], list(map(int, DropReason)))
"""Members of `DropReason` in compiled functions."""

NOT_MISSING = cast(DropReason, -1)
"""Result of `missing_reason` while frames arrive."""

JOINT_UNITS = ("rad", "rad", "mm")


@compiled
def joints_are_not_finite(facts: TickFacts) -> bool:
    """Detect joint positions that are not finite."""
    return not all_finite(facts.observation.q)


@compiled
def drive_went_off(facts: TickFacts) -> bool:
    """Detect a drive that is off although it is expected to be on."""
    return facts.drive_requested and not facts.observation.enabled


@compiled
def arm_is_silent(facts: TickFacts) -> bool:
    """Detect joint positions with a timestamp too far from the present."""
    return (
        not abs(facts.observation.now - facts.observation.q_time)
        <= facts.thresholds.arm_timeout * 1e9
    )


@compiled
def joint_is_beyond_limit(facts: TickFacts) -> bool:
    """Detect a joint beyond its limit by more than `limit_tolerance`."""
    return not is_within_limits(facts.rcm, facts.observation.q, facts.thresholds.limit_tolerance)


@compiled
def joints_do_not_follow(facts: TickFacts) -> bool:
    """Detect a following error: joints that differ from the commanded motion."""
    return exceeds_following_error(
        facts.observation.q, facts.monitor.predicted_joints, facts.thresholds
    )


@compiled
def joints_creep(facts: TickFacts) -> bool:
    """Detect motion of the joints while no motion is commanded."""
    rest = facts.monitor.rest_joints
    return all_finite(rest) and exceeds_following_error(facts.observation.q, rest, facts.thresholds)


@compiled
def exceeds_following_error(q: Floats, expected: Floats, thresholds: Thresholds) -> bool:
    """Return True if a joint of q (3,) deviates from `expected` (3,) by too much."""
    within = True
    for i in range(3):
        within = within and abs(q[i] - expected[i]) <= thresholds.max_following_error[i]
    return not within


@compiled
def clock_did_not_advance(facts: TickFacts) -> bool:
    """Detect a clock that stopped or went back."""
    return not facts.monitor.tick_interval > 0


@compiled
def loop_overran(facts: TickFacts) -> bool:
    """Detect several late ticks in succession, or one tick that is much too late."""
    thresholds, delay = facts.thresholds, facts.monitor.tick_interval - facts.period
    return (
        facts.monitor.late_ticks >= thresholds.max_late_ticks
        or not delay <= thresholds.max_tick_delay * 1e9
    )


@compiled
def tick_came_late(facts: TickFacts) -> bool:
    """Detect a late tick."""
    return facts.monitor.late_ticks > 0


@compiled
def recording_failed(facts: TickFacts) -> bool:
    """Detect a record that cannot be written any more."""
    return not facts.observation.recorded


@compiled
def joints_at_exposure_are_unknown(facts: TickFacts) -> bool:
    """Detect joint positions at the exposure that are unknown or beyond their limits."""
    q, slack = facts.observation.q_exposure, facts.thresholds.limit_tolerance
    return has_frame(facts) and not is_within_limits(facts.rcm, q, slack)


@compiled
def frames_come_late(facts: TickFacts) -> bool:
    """Detect a latency, from exposure to tick, that is too long."""
    return has_frame(facts) and not facts.monitor.latency <= facts.thresholds.max_latency * 1e9


@compiled
def frame_is_old(facts: TickFacts) -> bool:
    """Detect a newest frame that arrived longer ago than usual."""
    limit = facts.thresholds.max_frame_age_slow
    return has_frame(facts) and not periods_since(facts, facts.observation.arrival) <= limit


@compiled
def frames_stopped(facts: TickFacts) -> bool:
    """Detect that no frames arrive, or that none has arrived in a paused run."""
    return missing_reason(facts) == NOT_DROPPED or (facts.paused and not has_frame(facts))


@compiled
def frames_are_damaged(facts: TickFacts) -> bool:
    """Detect that only damaged frames arrive."""
    return missing_reason(facts) == DAMAGED


@compiled
def frames_are_not_new(facts: TickFacts) -> bool:
    """Detect frames that arrive repeatedly or out of order."""
    return missing_reason(facts) == NOT_NEW or facts.observation.frame < facts.monitor.newest_frame


@compiled
def frame_times_are_invalid(facts: TickFacts) -> bool:
    """Detect invalid timestamps.

    Either the frames are dropped for their timestamps, or frames arrive but always seem to be old.
    """
    return missing_reason(facts) == INVALID_TIME or (
        frames_are_missing(facts) and frames_still_arrive(facts)
    )


@compiled
def missing_reason(facts: TickFacts) -> DropReason:
    """Return the reason why the last frame was dropped; NOT_MISSING while frames arrive."""
    missing = frames_are_missing(facts) and not frames_still_arrive(facts)
    return facts.observation.drop_reason if missing else NOT_MISSING


@compiled
def frames_are_missing(facts: TickFacts) -> bool:
    """Return True if the newest frame arrived too long ago."""
    limit = facts.thresholds.max_frame_age_hold
    return has_frame(facts) and not periods_since(facts, facts.observation.arrival) <= limit


@compiled
def frames_still_arrive(facts: TickFacts) -> bool:
    """Return True if the newest frame was first used recently, whatever its timestamps say."""
    return periods_since(facts, facts.monitor.frame_time) <= facts.thresholds.max_frame_age_slow


@compiled
def periods_since(facts: TickFacts, time: int) -> float:
    """Return the number of frame periods since a time in ns."""
    watch, first = facts.monitor, facts.thresholds.initial_frame_period
    period = watch.frame_period if watch.frame_period != 0.0 else 1e9 * first
    return (facts.observation.now - time) / period


def describe_not_finite(facts: DetailFacts) -> str:
    """Describe the joints whose positions are not finite."""
    q, arm = facts.observation.q, facts.mechanism
    return "; ".join(_describe_joint(arm, i, q) for i in range(3) if not np.isfinite(q[i]))


def describe_limits(facts: DetailFacts) -> str:
    """Describe the joints beyond their limits."""
    lower, upper = facts.mechanism.limits.arrays
    slack, q, arm = (
        facts.thresholds.limit_tolerance * (upper - lower),
        facts.observation.q,
        facts.mechanism,
    )
    parts = [
        f"{_describe_joint(arm, i, q)}, its limits are {lower[i]:.4g} and {upper[i]:.4g}"
        for i in range(3)
        if not lower[i] - slack[i] <= q[i] <= upper[i] + slack[i]
    ]
    return "; ".join(parts)


def describe_following(facts: DetailFacts) -> str:
    """Describe the joints with a following error."""
    return _describe_deviations(facts, facts.monitor.predicted_joints, "should be")


def describe_creeping(facts: DetailFacts) -> str:
    """Describe the joints that move while no motion is commanded."""
    return _describe_deviations(facts, facts.monitor.rest_joints, "at rest it should stay")


def _describe_deviations(facts: DetailFacts, expected: Floats, verb: str) -> str:
    """Describe the joints that differ from `expected` (3,) by more than `max_following_error`."""
    q, limit, arm = facts.observation.q, facts.thresholds.max_following_error, facts.mechanism
    parts = [
        f"{_describe_joint(arm, i, q)}, and {verb} within {limit[i]:g} of {expected[i]:.4g}"
        for i in range(3)
        if not abs(q[i] - expected[i]) <= limit[i]
    ]
    return "; ".join(parts)


def _describe_joint(mechanism: Kinematics, i: int, q: Floats) -> str:
    return f"joint {i + 1} ({mechanism.joint_names[i]}) is at {q[i]:.4g} {JOINT_UNITS[i]}"
