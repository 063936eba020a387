"""State of the checks from tick to tick, and its updates: arm, loop, camera, markers and estimate.

The checks compare the measured joints with the commands of earlier ticks, the markers of a new
frame with their predictions, and the change of the features with the estimate. The detectors in
`rcmservo.safety.checks` read this state.
"""

from functools import partial

import numpy as np

from rcmservo.control.drive_response import (
    ResponseMeasurement,
    are_equal,
    select_possible_response,
)
from rcmservo.interfaces import NEVER_NS, Floats, Observation, ObservationStruct
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import (
    all_finite,
    compute_distance,
    compute_norm,
    copy_into,
    fill,
    subtract,
)
from rcmservo.numerics.structs import Row, Struct, flag, part, real, reals, whole
from rcmservo.safety.innovation import (
    ESTIMATE_CONTRADICTED,
    MOTION_TOO_SMALL,
    compare_with_estimate,
    find_jumps,
)
from rcmservo.safety.thresholds import Thresholds

MAX_STEADY_MOTION_PX = 15.0
"""Motion (px) of another object, detected as a marker, from one frame to the next. False detections
in noise are further apart."""

FRAME_PERIOD_SMOOTHING = 0.2
"""Weight of a new frame in the filtered frame period."""


class ObservationRow(Struct, source=Observation, without=("sizes", "quality")):
    """Observation of a tick, as a row of the state for compiled functions."""


POSSIBLE_RESPONSES = 4
"""Number of responses of the drives that the joints are predicted for."""

MAX_REPORT_PERIOD_NS = 60_000_000
"""Time (ns) for which joints may be repeated without counting as joints that rest."""

REPORT_PERIOD_SMOOTHING = 0.2
"""Weight of a new interval in the filtered period of the joints."""

SLOW_RATIO = 4.0
"""Rate (1/s) of a slow joint in units of `max_following_error`: 0.032 rad/s or 2.4 mm/s."""

SLOW_DECAY_S = 0.125
"""Time constant (s) of the following error of a slow joint while servoing.

It is then at most half of `max_following_error`: a drive may rest at small rates.
"""

MOVED_RATIO, UNFOLLOWED_RATIO = 0.1, 0.3
"""Motion of a joint that moves, and commanded motion after which one that does not rests, in units
of `max_following_error`."""

count, markers = partial(whole, ""), partial(reals, (2, 2), "px")
"""Declarations of fields: a number of events, and the pixels of both markers."""


class MonitorState(Row):
    """State of the checks from tick to tick, for compiled functions.

    The projection fit predicts the markers. A residual is the difference between a detected marker
    and its prediction.
    """

    observation: ObservationRow = part(ObservationRow, "observation of this tick")
    predicted_joints: Floats = reals(
        (POSSIBLE_RESPONSES, 3), "rad, rad, mm", "joints predicted from the commands, by response"
    )
    predicted_rates: Floats = reals(
        (POSSIBLE_RESPONSES, 3), "rad/s, rad/s, mm/s", "rates predicted in the same way"
    )
    rest_positions: Floats = reals(3, "rad, rad, mm", "each joint when it last moved, if slowly")
    unfollowed: Floats = reals(3, "rad, rad, mm", "motion that has been commanded since")
    rests_since: int = whole("ns", "time since which a joint does not follow, or NEVER_NS")
    resting_rates: Floats = reals(
        3, "rad/s, rad/s, mm/s", "largest rate at which each joint has rested, 0 if it has not"
    )
    reported_joints: Floats = reals(3, "rad, rad, mm", "newest joints that differ from the last")
    reported_at: int = whole("ns", "time of the first tick with them")
    report_period: float = real("ns", "filtered time between two such joints in motion, 0 unknown")
    reports_are_timed: bool = flag("True if the joints have moved since the newest report")
    was_measuring: bool = flag("True if the drives' response was being measured at the last tick")
    joints_are_fresh: bool = flag("False if this tick repeats joints that were read before")
    joints_time: int = whole("ns", "time of the newest joint positions")
    idle_since: int = whole("ns", "time since which no motion is commanded, or NEVER_NS")
    rest_joints: Floats = reals(3, "rad, rad, mm", "joints at rest since then, NaN until settled")
    late_ticks: int = count("number of successive late ticks")
    tick_interval: int = whole("ns", "time between the last two ticks")
    newest_frame: int = count("number of the newest frame, -1 before the first")
    accepted_frame: int = count("number of the newest accepted frame, -1 before the first")
    exposure: int = whole("ns", "exposure time of the newest frame")
    frame_time: int = whole("ns", "time of the first tick with the newest frame")
    frame_period: float = real("ns", "filtered time between frames, 0 while unknown")
    latency: int = whole("ns", "time from the newest frame's exposure to its first tick")
    one_marker_suffices: bool = flag("True if one marker is lost and the other determines the pose")
    rejected_frames: int = count("number of successive rejected frames")
    steady_frames: int = count("rejected frames in succession whose deviating markers stay")
    jumped_frames: int = count("rejected frames in which both markers jumped to a steady position")
    agreeing_frames: int = count("accepted frames since the start, while the tool has not explored")
    first_frame_is_wrong: bool = flag("True if later frames agree with each other, not with it")
    swapped_frames: int = count("rejected frames with each marker at the other's position")
    rejected_markers: Floats = markers("markers of the newest rejected frame")
    mean_residual: Floats = markers("mean residual of each marker")
    averaged_frames: int = count("number of frames in the mean residual")
    residual_sums: Floats = reals(2, "mm², 1", "squares of the mean residuals on the way, number")
    sampled_p1: Floats = reals(3, "mm", "marker 1 at the newest of these residuals")
    drift_px: Floats = reals(2, "px", "norm of the mean residual, 0 where noise explains it")
    drifts: Floats = reals(2, "", "1 where neither noise nor errors of the arm explain it, else 0")
    changed_markers: Floats = markers("newest markers that differed from those before")
    markers_prediction: Floats = markers("prediction for the newest markers")
    repeated_frames: int = count("number of successive frames that repeat `changed_markers`")
    image_frozen: bool = flag("True if the markers did not change although the tool moved")
    changed_markers_p1: Floats = reals(3, "mm", "marker 1 when `changed_markers` first appeared")
    stuck_anchors: Floats = reals((2, 4), "px", "stop of each marker, and the other marker then")
    path_p1: Floats = reals(3, "mm", "marker 1 in the last frame before exploration has ended")
    still_paths: Floats = reals(2, "mm", "path of marker 1 since the stop of each marker")
    still_markers: int = whole("", "bits 1 and 2: markers that do not move with the tool")
    compared_p1: Floats = reals(3, "mm", "marker 1 at the last comparison with the estimate")
    compared_markers: Floats = markers("markers at the last comparison with the estimate")
    contradictions: int = count("number of successive comparisons that contradict the estimate")


def initial_monitor_state() -> MonitorState:
    """Return the state before the first observation."""
    unknown_positions = (
        "predicted_joints",
        "reported_joints",
        "rest_joints",
        "compared_p1",
        "path_p1",
    )
    unknown_markers = "rejected_markers", "compared_markers", "changed_markers"
    unknown = dict.fromkeys((*unknown_positions, *unknown_markers), np.nan)
    never = {"idle_since": NEVER_NS, "rests_since": NEVER_NS}
    return MonitorState.of(newest_frame=-1, accepted_frame=-1, **never, **unknown)


@compiled
def reset_monitor(monitor: MonitorState, resets_markers: bool) -> None:
    """Reset the counts of late ticks, drift and contradictions.

    With ``resets_markers``, reset the counts of the markers and their residuals on the way too;
    then no frame counts as accepted.
    """
    monitor.late_ticks, monitor.contradictions, monitor.averaged_frames = 0, 0, 0
    monitor.image_frozen = False
    fill(monitor.drift_px, 0.0)
    fill(monitor.drifts, 0.0)
    fill(monitor.compared_p1, np.nan)
    if resets_markers:
        reset_rejections(monitor)
        monitor.accepted_frame, monitor.one_marker_suffices = -1, False
        monitor.agreeing_frames, monitor.first_frame_is_wrong = 0, False
        fill(monitor.stuck_anchors, np.nan)
        fill(monitor.residual_sums, 0.0)


@compiled
def reset_rejections(monitor: MonitorState) -> None:
    """Set the counts of rejected frames to zero."""
    monitor.rejected_frames, monitor.steady_frames = 0, 0
    monitor.jumped_frames, monitor.swapped_frames = 0, 0


@compiled
def monitor_loop(
    monitor: MonitorState,
    interval_ns: int,
    period_ns: int,
    drives: ResponseMeasurement,
    is_servoing: bool,
    thresholds: Thresholds,
) -> None:
    """Update the state of loop and arm at a tick.

    Count late ticks, predict the joints from the commands, and store their rest position.

    Parameters
    ----------
    monitor : MonitorState
        State of the checks; updated.
    interval_ns, period_ns : int
        Time since the last tick, and its nominal value, ns.
    drives : ResponseMeasurement
        Measured gains and lag of the drives.
    is_servoing : bool
        True if the image checks the motion too.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    observation = monitor.observation
    is_late = interval_ns > (1.0 + thresholds.late_tick_fraction) * period_ns
    monitor.tick_interval = interval_ns
    monitor.late_ticks = monitor.late_ticks + 1 if is_late else 0
    monitor_reports(monitor, thresholds)
    if observation.enabled and all_finite(monitor.predicted_joints):
        predict_joints(monitor, drives, is_servoing, thresholds)
        find_resting_joints(monitor, is_servoing, thresholds)
    else:
        for k in range(POSSIBLE_RESPONSES):
            copy_into(monitor.predicted_joints[k], observation.q)
        fill(monitor.predicted_rates, 0.0)
    monitor_rest(monitor, thresholds)
    monitor.joints_time = observation.q_time


@compiled
def monitor_reports(monitor: MonitorState, thresholds: Thresholds) -> None:
    """Find out if the joints of this tick are new, or are repeated by a slow arm."""
    observation = monitor.observation
    is_new, is_moving = not are_equal(observation.q, monitor.reported_joints), False
    for i in range(3):
        is_moving = is_moving or not is_slow_joint(observation, i, thresholds)
    if is_new and is_moving and monitor.reports_are_timed:
        interval, period = float(observation.now - monitor.reported_at), monitor.report_period
        change = REPORT_PERIOD_SMOOTHING * (interval - period) if period > 0.0 else interval
        monitor.report_period += change
    monitor.reports_are_timed = is_moving and (is_new or monitor.reports_are_timed)
    if is_new:
        copy_into(monitor.reported_joints, observation.q)
        monitor.reported_at = observation.now
    is_overdue = observation.now - monitor.reported_at > MAX_REPORT_PERIOD_NS
    monitor.joints_are_fresh = is_new or is_overdue


@compiled
def predict_joints(
    monitor: MonitorState,
    drives: ResponseMeasurement,
    is_servoing: bool,
    thresholds: Thresholds,
) -> None:
    """Predict the joints at the newest joint positions, for each possible response of the drives.

    The predictions converge to the measured joints with the time constant `following_error_decay`,
    or a shorter one for a slow joint while servoing.
    """
    observation = monitor.observation
    dt = max(observation.q_time - monitor.joints_time, 0) * 1e-9
    share = dt if monitor.joints_are_fresh else 0.0
    has_measured = monitor.was_measuring and not drives.is_measuring and drives.lag > 0.0
    if has_measured and monitor.joints_are_fresh:
        restart_predictions(monitor, drives)
        return
    monitor.was_measuring = drives.is_measuring or has_measured
    for k in range(POSSIBLE_RESPONSES):
        joints, rates = monitor.predicted_joints[k], monitor.predicted_rates[k]
        for i in range(3):
            gain, lag_s = select_possible_response(drives, i, k, thresholds.drive_lag)
            rate = gain * observation.applied[i]
            joint, rates[i] = predict_joint(joints[i], rates[i], rate, lag_s, dt)
            is_slow = is_servoing and is_slow_joint(observation, i, thresholds)
            decay_s = thresholds.following_error_decay
            decay_s = min(decay_s, SLOW_DECAY_S) if is_slow else decay_s
            joints[i] = joint + (observation.q[i] - joint) * min(share / decay_s, 1.0)


@compiled
def is_slow_joint(observation: ObservationRow, i: int, thresholds: Thresholds) -> bool:
    """Return True if the commanded rate of joint i is small."""
    return abs(observation.applied[i]) <= SLOW_RATIO * thresholds.max_following_error[i]


@compiled
def find_resting_joints(monitor: MonitorState, is_servoing: bool, thresholds: Thresholds) -> None:
    """Store at which small rates a joint does not move, because of a dead zone or stiction."""
    observation = monitor.observation
    dt, rests = max(observation.q_time - monitor.joints_time, 0) * 1e-9, False
    for i in range(3):
        q, limit = observation.q[i], thresholds.max_following_error[i]
        monitor.unfollowed[i] += observation.applied[i] * dt
        has_moved = abs(q - monitor.rest_positions[i]) > MOVED_RATIO * limit
        if has_moved or not (is_servoing and is_slow_joint(observation, i, thresholds)):
            monitor.rest_positions[i], monitor.unfollowed[i] = q, 0.0
        elif abs(monitor.unfollowed[i]) > UNFOLLOWED_RATIO * limit:
            rate, rests = abs(observation.applied[i]), True
            monitor.resting_rates[i] = max(monitor.resting_rates[i], rate)
    if not rests:
        monitor.rests_since = NEVER_NS
    elif monitor.rests_since == NEVER_NS:
        monitor.rests_since = observation.now


@compiled
def restart_predictions(monitor: MonitorState, drives: ResponseMeasurement) -> None:
    """Let all predictions start at the joints and rates of now, as their response is known now."""
    observation, dt = monitor.observation, (monitor.observation.q_time - drives.read_at) * 1e-9
    monitor.was_measuring = False
    for k in range(POSSIBLE_RESPONSES):
        for i in range(3):
            motion = observation.q[i] - drives.newest_joints[i]
            monitor.predicted_joints[k, i] = observation.q[i]
            monitor.predicted_rates[k, i] = motion / dt if dt > 0.0 else 0.0


@compiled
def predict_joint(
    q: float, rate: float, applied: float, lag_s: float, dt: float
) -> tuple[float, float]:
    """Return the position and the rate of a joint dt s later.

    The drive follows the rate `applied` as a first-order system with the time constant `lag_s`.
    """
    decay, excess = np.exp(-dt / lag_s), rate - applied
    return q + applied * dt + excess * lag_s * (1.0 - decay), applied + excess * decay


@compiled
def monitor_rest(monitor: MonitorState, thresholds: Thresholds) -> None:
    """Store the rest position of the joints `settling_time` s after the last commanded motion."""
    observation, now = monitor.observation, monitor.observation.now
    settling_ns = thresholds.settling_time * 1e9
    if not (observation.enabled and compute_norm(observation.applied) == 0.0):
        monitor.idle_since = NEVER_NS
        fill(monitor.rest_joints, np.nan)
    elif monitor.idle_since == NEVER_NS:
        monitor.idle_since = now
    elif not all_finite(monitor.rest_joints) and now - monitor.idle_since >= settling_ns:
        copy_into(monitor.rest_joints, observation.q)


@compiled
def store_observation(row: ObservationRow, observation: ObservationStruct) -> None:
    """Copy the observation into a row."""
    row.now, row.q_time, row.enabled = observation.now, observation.q_time, observation.enabled
    row.frame, row.exposure = observation.frame, observation.exposure
    row.arrival, row.drop_reason = observation.arrival, observation.drop_reason
    row.recorded = observation.recorded
    copy_into(row.q, observation.q)
    copy_into(row.applied, observation.applied)
    copy_into(row.q_exposure, observation.q_exposure)
    copy_into(row.points, observation.points)


@compiled
def monitor_frame(
    monitor: MonitorState, observation: ObservationRow, thresholds: Thresholds
) -> None:
    """Update the latency and the low-pass filtered frame period with a new frame.

    A gap between frames enters the period only up to `max_frame_age_slow` periods.
    """
    frame, exposure, period_ns = observation.frame, observation.exposure, monitor.frame_period
    if monitor.newest_frame >= 0:
        new_period_ns = (exposure - monitor.exposure) / (frame - monitor.newest_frame)
        if period_ns != 0.0:
            new_period_ns = min(new_period_ns, thresholds.max_frame_age_slow * period_ns)
            monitor.frame_period = period_ns + FRAME_PERIOD_SMOOTHING * (new_period_ns - period_ns)
        else:
            monitor.frame_period = min(new_period_ns, 1e9 * thresholds.initial_frame_period)
    monitor.newest_frame, monitor.exposure, monitor.frame_time = frame, exposure, observation.now
    monitor.latency = observation.now - exposure


@compiled
def markers_stay(monitor: MonitorState, points: Floats, thresholds: Thresholds) -> bool:
    """Return True if the markers (2, 2) px are at their positions in the last, rejected frame."""
    limit_px = thresholds.jump_agreement * thresholds.max_jump_px
    first_jumped, second_jumped, _ = find_jumps(
        points, monitor.rejected_markers, 0.0, limit_px, thresholds.max_px_per_mm
    )
    return monitor.rejected_frames > 0 and not (first_jumped or second_jumped)


@compiled
def jumps_from_rejected(monitor: MonitorState, points: Floats, k: int) -> bool:
    """Return True if marker k is far from its position in the last rejected frame."""
    return compute_distance(points[k], monitor.rejected_markers[k]) > MAX_STEADY_MOTION_PX


@compiled
def monitor_markers(
    monitor: MonitorState,
    first_deviates: bool,
    second_deviates: bool,
    is_swapped: bool,
    points: Floats,
    accepted_points: Floats,
    thresholds: Thresholds,
) -> None:
    """Count rejected frames, jumps and swaps of the markers with a new frame.

    Both markers have jumped only if their new positions agree from frame to frame, as false
    detections do not, and if one has left its position in the last accepted frame, as in a frozen
    image none does.

    Parameters
    ----------
    monitor : MonitorState
        State of the checks; updated.
    first_deviates, second_deviates : bool
        True if marker 1 or marker 2 is too far from its prediction.
    is_swapped : bool
        True if each marker is at the other's position.
    points, accepted_points : Floats
        Markers, (2, 2) raw px, and those of the last accepted frame.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    if not (first_deviates or second_deviates):
        reset_rejections(monitor)
        return
    both_deviate = first_deviates and second_deviates
    jumps = find_jumps(points, accepted_points, 0.0, thresholds.max_jump_px, 0.0)
    has_jumped = both_deviate and (jumps[0] or jumps[1])
    is_steady = monitor.rejected_frames == 0 or markers_stay(monitor, points, thresholds)
    stays = not (first_deviates and jumps_from_rejected(monitor, points, 0)) and not (
        second_deviates and jumps_from_rejected(monitor, points, 1)
    )
    monitor.rejected_frames += 1
    monitor.steady_frames = monitor.steady_frames + 1 if stays else 1
    earlier_jumps = monitor.jumped_frames if is_steady else 0
    monitor.jumped_frames = earlier_jumps + 1 if has_jumped else 0
    monitor.swapped_frames = monitor.swapped_frames + 1 if both_deviate and is_swapped else 0
    copy_into(monitor.rejected_markers, points)


@compiled
def monitor_estimate(
    monitor: MonitorState,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    J_hat: Floats,
    thresholds: Thresholds,
) -> None:
    """Compare the estimate with the change of the features since the last comparison.

    Parameters
    ----------
    monitor : MonitorState
        State of the checks; updated.
    p1 : Floats
        Position of marker 1, (3,) mm.
    points : Floats
        Markers, (2, 2) raw px.
    o_c : Floats
        Imaged RCM, (2,) raw px.
    J_hat : Floats
        Estimated Jacobian Ĵ, (3, 3).
    thresholds : Thresholds
        Thresholds of the checks.
    """
    if all_finite(monitor.compared_p1):
        delta_p, earlier_points = subtract(p1, monitor.compared_p1), monitor.compared_markers
        min_change, max_error = thresholds.min_predicted_change, thresholds.max_change_error
        comparison = compare_with_estimate(
            points, earlier_points, o_c, J_hat, delta_p, min_change, max_error
        )
        if comparison == MOTION_TOO_SMALL:
            return
        contradicts = comparison == ESTIMATE_CONTRADICTED
        monitor.contradictions = monitor.contradictions + 1 if contradicts else 0
    copy_into(monitor.compared_p1, p1)
    copy_into(monitor.compared_markers, points)
