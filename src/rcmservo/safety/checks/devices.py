"""Detectors of faults of the arm, the loop, the record and the frames.

Every comparison is written so that NaN triggers the cause.
"""

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.control.drive_response import EXACT_GAIN, compute_gain
from rcmservo.geometry.kinematics import is_within_limits
from rcmservo.interfaces import NEVER_NS, DropReason, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite
from rcmservo.safety.checks.facts import DetailFacts, TickFacts, has_frame
from rcmservo.safety.monitor_state import MAX_REPORT_PERIOD_NS, MonitorState
from rcmservo.safety.thresholds import Thresholds

NOT_DROPPED, NOT_NEW, INVALID_TIME, DAMAGED = cast(list[DropReason], list(map(int, DropReason)))
"""Codes of `DropReason` in compiled functions."""

NOT_MISSING = cast(DropReason, -1)
"""Result of `find_missing_reason` while frames arrive."""

JOINT_UNITS = ("rad", "rad", "mm")

MAX_REST_S, MAX_REST_MM = 2.0, 1.0
"""A joint may rest at small rates for this time (s) farther from the target than this (mm)."""


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
    age_ns = abs(facts.observation.now - facts.observation.q_time)
    return not age_ns <= facts.thresholds.arm_timeout * 1e9


@compiled
def joint_is_beyond_limit(facts: TickFacts) -> bool:
    """Detect a joint beyond its limit by more than `limit_tolerance`."""
    return not is_within_limits(facts.rcm, facts.observation.q, facts.thresholds.limit_tolerance)


@compiled
def joints_do_not_follow(facts: TickFacts) -> bool:
    """Detect a following error: joints that differ from the commanded motion.

    Before the drives' response is measured they may be anywhere between the predictions for all
    possible responses. A joint that rests at small rates is one far from the target only.
    """
    q, monitor, lower, upper = facts.observation.q, facts.monitor, np.empty(3), np.empty(3)
    for i in range(3):
        lower[i], upper[i] = np.inf, -np.inf
        for k in range(len(monitor.predicted_joints)):
            lower[i] = min(lower[i], monitor.predicted_joints[k, i])
            upper[i] = max(upper[i], monitor.predicted_joints[k, i])
    exceeds = exceeds_following_error(q, lower, upper, facts.thresholds)
    return joints_rest_far_away(facts) or (monitor.joints_are_fresh and exceeds)


@compiled
def joints_rest_far_away(facts: TickFacts) -> bool:
    """Return True if a joint rests too long at small rates, far from the target."""
    since, now = facts.monitor.rests_since, facts.observation.now
    rests_for_long = since != NEVER_NS and now - since > MAX_REST_S * 1e9
    return rests_for_long and facts.progress.remaining_mm > MAX_REST_MM


@compiled
def joints_creep(facts: TickFacts) -> bool:
    """Detect motion of the joints while no motion is commanded.

    The rest position of the joints is NaN until they have come to rest.
    """
    q, rest_joints = facts.observation.q, facts.monitor.rest_joints
    return all_finite(rest_joints) and exceeds_following_error(
        q, rest_joints, rest_joints, facts.thresholds
    )


@compiled
def exceeds_following_error(
    q: Floats, lower: Floats, upper: Floats, thresholds: Thresholds
) -> bool:
    """Return True if a joint of q (3,) is off its range by more than `max_following_error`.

    The range is from `lower` (3,) to `upper` (3,).
    """
    is_within = True
    for i in range(3):
        limit = thresholds.max_following_error[i]
        is_within = is_within and lower[i] - limit <= q[i] <= upper[i] + limit
    return not is_within


@compiled
def clock_did_not_advance(facts: TickFacts) -> bool:
    """Detect a clock that stopped or went back."""
    return not facts.monitor.tick_interval > 0


@compiled
def loop_overran(facts: TickFacts) -> bool:
    """Detect several late ticks in succession, or one tick that is much too late."""
    thresholds, delay_ns = facts.thresholds, facts.monitor.tick_interval - facts.period
    is_much_too_late = not delay_ns <= thresholds.max_tick_delay * 1e9
    return facts.monitor.late_ticks >= thresholds.max_late_ticks or is_much_too_late


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
    q, tolerance = facts.observation.q_exposure, facts.thresholds.limit_tolerance
    return has_frame(facts) and not is_within_limits(facts.rcm, q, tolerance)


@compiled
def frames_come_late(facts: TickFacts) -> bool:
    """Detect a latency, from exposure to tick, that is too long."""
    return has_frame(facts) and not facts.monitor.latency <= facts.thresholds.max_latency * 1e9


@compiled
def frame_is_old(facts: TickFacts) -> bool:
    """Detect a newest frame that arrived longer ago than usual."""
    age_periods = count_periods_since(facts, facts.observation.arrival)
    return has_frame(facts) and not age_periods <= facts.thresholds.max_frame_age_slow


@compiled
def frames_stopped(facts: TickFacts) -> bool:
    """Detect that no frames arrive, or that none has arrived in a paused run."""
    return find_missing_reason(facts) == NOT_DROPPED or (facts.paused and not has_frame(facts))


@compiled
def frames_are_damaged(facts: TickFacts) -> bool:
    """Detect that only damaged frames arrive."""
    return find_missing_reason(facts) == DAMAGED


@compiled
def frames_are_not_new(facts: TickFacts) -> bool:
    """Detect frames that arrive repeatedly or out of order."""
    is_out_of_order = facts.observation.frame < facts.monitor.newest_frame
    return is_out_of_order or find_missing_reason(facts) == NOT_NEW


@compiled
def frame_times_are_invalid(facts: TickFacts) -> bool:
    """Detect invalid timestamps.

    Either the frames are dropped for their timestamps, or frames arrive but always seem to be old.
    """
    always_seem_old = frames_are_missing(facts) and frames_still_arrive(facts)
    return find_missing_reason(facts) == INVALID_TIME or always_seem_old


@compiled
def find_missing_reason(facts: TickFacts) -> DropReason:
    """Return the reason why the last frame was dropped; NOT_MISSING while frames arrive."""
    is_missing = frames_are_missing(facts) and not frames_still_arrive(facts)
    return facts.observation.drop_reason if is_missing else NOT_MISSING


@compiled
def frames_are_missing(facts: TickFacts) -> bool:
    """Return True if the newest frame arrived too long ago."""
    age_periods = count_periods_since(facts, facts.observation.arrival)
    return has_frame(facts) and not age_periods <= facts.thresholds.max_frame_age_hold


@compiled
def frames_still_arrive(facts: TickFacts) -> bool:
    """Return True if the newest frame was first used recently, whatever its timestamps say."""
    age_periods = count_periods_since(facts, facts.monitor.frame_time)
    return age_periods <= facts.thresholds.max_frame_age_slow


@compiled
def count_periods_since(facts: TickFacts, time_ns: int) -> float:
    """Return the number of frame periods, with fraction, since a time."""
    period_ns = facts.monitor.frame_period
    if period_ns == 0.0:
        period_ns = 1e9 * facts.thresholds.initial_frame_period
    return (facts.observation.now - time_ns) / period_ns


def describe_not_finite(facts: DetailFacts) -> str:
    """Describe the joints whose positions are not finite."""
    return _describe_joints(facts, np.isfinite(facts.observation.q), lambda joint: "")


def describe_limits(facts: DetailFacts) -> str:
    """Describe the joints beyond their limits."""
    q, (lower, upper) = facts.observation.q, facts.mechanism.limits.arrays
    margin = facts.thresholds.limit_tolerance * (upper - lower)

    def describe_range(joint: int) -> str:
        return f", its limits are {lower[joint]:.4g} and {upper[joint]:.4g}"

    is_within = (lower - margin <= q) & (q <= upper + margin)
    return _describe_joints(facts, is_within, describe_range)


def describe_following(facts: DetailFacts) -> str:
    """Describe the joints with a following error, and by which ratio they have followed."""
    predicted = facts.monitor.predicted_joints
    expected = np.clip(facts.observation.q, predicted.min(axis=0), predicted.max(axis=0))
    deviations = _describe_deviations(facts, expected, "should be")
    rests = _describe_rest(facts) if facts.monitor.rests_since != NEVER_NS else ""
    gains = [compute_gain(facts.drives.rows[0], i) for i in range(3)]
    ratios = [
        f"joint {i + 1} followed by {100.0 * gain:.0f} % while exploring: is a speed override set?"
        for i, gain in enumerate(gains)
        if 0.05 < gain < 1.0 - EXACT_GAIN or gain > 1.0 + EXACT_GAIN
    ]
    return "; ".join(text for text in (deviations, rests, *ratios) if text)


def _describe_rest(facts: DetailFacts) -> str:
    """Describe the joints that have not moved at small rates."""
    rates, names = facts.monitor.resting_rates, facts.mechanism.joint_names
    return "; ".join(
        f"joint {i + 1} ({names[i]}) rests at rates up to {rates[i]:.2g} {JOINT_UNITS[i]}/s, by a "
        "dead zone, friction or a blocked axis"
        for i in range(3)
        if rates[i] > 0.0
    )


def describe_slow_reports(monitor: MonitorState) -> str:
    """Describe joints that arrive too seldom; empty if they arrive often enough or never moved."""
    if not monitor.report_period > MAX_REPORT_PERIOD_NS:
        return ""
    return (
        f"new joints arrive at {1e9 / monitor.report_period:.0f} Hz only: let the arm report them "
        f"at {1e9 / MAX_REPORT_PERIOD_NS:.0f} Hz or more"
    )


def describe_creeping(facts: DetailFacts) -> str:
    """Describe the joints that move while no motion is commanded."""
    return _describe_deviations(facts, facts.monitor.rest_joints, "at rest it should stay")


def _describe_deviations(facts: DetailFacts, expected: Floats, verb: str) -> str:
    """Describe the joints that differ from `expected` (3,) by more than `max_following_error`."""
    limit = facts.thresholds.max_following_error

    def describe_expected(joint: int) -> str:
        return f", and {verb} within {limit[joint]:g} of {expected[joint]:.4g}"

    is_within = abs(facts.observation.q - expected) <= limit
    return _describe_joints(facts, is_within, describe_expected)


def _describe_joints(
    facts: DetailFacts, is_valid: NDArray[np.bool_], describe_expected: Callable[[int], str]
) -> str:
    """Describe the positions of the joints that are not valid, and what is expected of each."""
    q, names = facts.observation.q, facts.mechanism.joint_names
    return "; ".join(
        f"joint {i + 1} ({names[i]}) is at {q[i]:.4g} {JOINT_UNITS[i]}{describe_expected(i)}"
        for i in range(3)
        if not is_valid[i]
    )
