"""State of the checks from tick to tick: arm, loop, camera, markers and estimate.

The checks compare the joints with the earlier commands, and a new frame with the motion since the
last one.
"""

import numpy as np

from rcmservo.interfaces import Floats, Observation, ObservationStruct
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_norm, copy_into, subtract
from rcmservo.numerics.structs import Row, Struct, flag, part, real, reals, whole
from rcmservo.safety.innovation import compare_with_estimate, find_jumps
from rcmservo.safety.thresholds import Thresholds

ZERO_VECTOR = np.zeros(3)
NAN_VECTOR = np.full(3, np.nan)


class ObservationRow(Struct, source=Observation, without=("sizes", "quality")):
    """Observation of a tick, as a row of the state.

    Compiled functions pass a row on without counting references to it.
    """


class MonitorState(Row):
    """State of the checks."""

    observation: ObservationRow = part(ObservationRow, "observation of this tick")
    predicted_joints: Floats = reals(
        3, "rad, rad, mm", "joint positions predicted from the commands"
    )
    predicted_rates: Floats = reals(
        3, "rad/s, rad/s, mm/s", "joint rates predicted with the drive's lag"
    )
    joints_time: int = whole("ns", "time of the newest joint positions")
    idle_since: int = whole(
        "ns", "start of the time without a commanded motion, -1 during a motion"
    )
    rest_joints: Floats = reals(
        3, "rad, rad, mm", "joint positions at rest in this time, NaN before"
    )
    late_ticks: int = whole("", "number of successive late ticks")
    tick_interval: int = whole("ns", "time between the last two ticks")
    newest_frame: int = whole("", "number of the newest frame, -1 before the first")
    accepted_frame: int = whole("", "number of the newest accepted frame, -1 before the first")
    exposure: int = whole("ns", "exposure time of the newest frame")
    frame_time: int = whole("ns", "time of the first tick with the newest frame")
    frame_period: float = real("ns", "filtered time between frames, 0 while unknown")
    latency: int = whole("ns", "time from the newest frame's exposure to its first tick")
    one_marker_suffices: bool = flag("True if one marker is lost and the other determines the pose")
    rejected_frames: int = whole("", "number of successive rejected frames")
    jumped_frames: int = whole(
        "", "number of these in which both markers jumped to a steady position"
    )
    swapped_frames: int = whole("", "number of these with each marker at the other's position")
    rejected_markers: Floats = reals((2, 2), "px", "markers of the newest rejected frame")
    mean_residual: Floats = reals((2, 2), "px", "mean residual of the fit at each marker")
    averaged_frames: int = whole("", "number of frames in this mean")
    drift_px: Floats = reals(2, "px", "norm of this mean, 0 where noise explains it")
    changed_markers: Floats = reals((2, 2), "px", "newest markers that differed from those before")
    changed_markers_prediction: Floats = reals(
        (2, 2), "px", "prediction of the fit for these markers"
    )
    markers_prediction: Floats = reals((2, 2), "px", "prediction of the fit for the newest markers")
    image_frozen: bool = flag("True if the markers did not change although the tool moved")
    changed_markers_p1: Floats = reals(3, "mm", "p₁ of the first frame with these markers")
    stuck_anchors: Floats = reals(
        (2, 4), "px", "where each marker stopped, and where the other was then"
    )
    compared_p1: Floats = reals(
        3, "mm", "position of marker 1 at the last comparison with the estimate"
    )
    compared_markers: Floats = reals((2, 2), "px", "markers at this comparison")
    contradictions: int = whole("", "number of successive comparisons that contradict the estimate")


def initial_monitor_state() -> MonitorState:
    """Return the state before the first observation."""
    positions = "predicted_joints", "rest_joints", "compared_p1"
    markers = "rejected_markers", "compared_markers", "changed_markers"
    unknown = dict.fromkeys((*positions, *markers), np.nan)
    return MonitorState.of(idle_since=-1, newest_frame=-1, accepted_frame=-1, **unknown)


@compiled
def reset_monitor(watch: MonitorState, markers: bool) -> None:
    """Reset the counts of the same arm and camera.

    With ``markers``, reset the counts of the markers too; then no frame counts as accepted.
    """
    watch.late_ticks, watch.contradictions, watch.averaged_frames, watch.image_frozen = (
        0,
        0,
        0,
        False,
    )
    copy_into(watch.drift_px, ZERO_VECTOR[:2])
    copy_into(watch.compared_p1, NAN_VECTOR)
    if markers:
        watch.rejected_frames, watch.jumped_frames, watch.swapped_frames = 0, 0, 0
        watch.accepted_frame, watch.one_marker_suffices = -1, False


@compiled
def predict_joints(
    reached: Floats, rates: Floats, applied: Floats, q: Floats, dt: float, lag: float, forget: float
) -> None:
    """Predict the joints and their rates ``dt`` s later, in place.

    The drives follow the applied rates as first-order systems with the time constant ``lag`` s. The
    prediction converges to the measured joints with the time constant ``following_error_decay`` s.

    Parameters
    ----------
    reached, rates : Floats
        Predicted joints and joint rates, (3,); overwritten.
    applied : Floats
        Joint rates that the arm applies, (3,).
    q : Floats
        Measured joints, (3,).
    dt, lag, forget : float
        Times in s.
    """
    decay, correction = np.exp(-dt / lag), min(dt / forget, 1.0)
    for i in range(3):
        lead = rates[i] - applied[i]
        predicted = reached[i] + applied[i] * dt + lead * lag * (1.0 - decay)
        reached[i] = predicted + (q[i] - predicted) * correction
        rates[i] = applied[i] + lead * decay


@compiled
def monitor_loop(
    watch: MonitorState, gap: int, period: int, lag: float, thresholds: Thresholds
) -> None:
    """Update the state of loop and arm at a tick.

    Count late ticks, predict the joints from the commands, and store their rest position.

    Parameters
    ----------
    watch : MonitorState
        State of the checks; updated.
    gap, period : int
        Time since the last tick, and its nominal value, ns.
    lag : float
        Time constant of the drives, s.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    observation, reached, watch.tick_interval = watch.observation, watch.predicted_joints, gap
    watch.late_ticks = (
        watch.late_ticks + 1 if gap > (1.0 + thresholds.late_tick_fraction) * period else 0
    )
    if observation.enabled and all_finite(reached):
        applied, dt = observation.applied, max(observation.q_time - watch.joints_time, 0) * 1e-9
        predict_joints(
            reached,
            watch.predicted_rates,
            applied,
            observation.q,
            dt,
            lag,
            thresholds.following_error_decay,
        )
    else:
        copy_into(reached, observation.q)
        copy_into(watch.predicted_rates, ZERO_VECTOR)
    monitor_rest(watch, observation, thresholds)
    watch.joints_time = observation.q_time


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
def monitor_rest(watch: MonitorState, observation: ObservationRow, thresholds: Thresholds) -> None:
    """Store the rest position of the joints `settling_time` s after the last commanded motion."""
    now, delay = observation.now, thresholds.settling_time * 1e9
    if not (observation.enabled and compute_norm(observation.applied) == 0.0):
        watch.idle_since = -1
        copy_into(watch.rest_joints, NAN_VECTOR)
    elif watch.idle_since < 0:
        watch.idle_since = now
    elif not all_finite(watch.rest_joints) and now - watch.idle_since >= delay:
        copy_into(watch.rest_joints, observation.q)


@compiled
def monitor_frame(watch: MonitorState, observation: ObservationRow, thresholds: Thresholds) -> None:
    """Update the latency and the low-pass filtered frame period with a new frame.

    A gap between frames enters the period only up to `max_frame_age_slow` periods.
    """
    frame, exposure = observation.frame, observation.exposure
    if watch.newest_frame >= 0:
        one, period = (exposure - watch.exposure) / (frame - watch.newest_frame), watch.frame_period
        slow, first = thresholds.max_frame_age_slow, thresholds.initial_frame_period
        one = min(one, slow * period if period != 0.0 else 1e9 * first)
        watch.frame_period = period + 0.2 * (one - period) if period != 0.0 else one
    watch.newest_frame, watch.exposure, watch.frame_time = frame, exposure, observation.now
    watch.latency = observation.now - exposure


@compiled
def markers_stay(watch: MonitorState, points: Floats, thresholds: Thresholds) -> bool:
    """Return True if the markers (2, 2) px are still where the last, rejected frame had them."""
    limit = thresholds.jump_agreement * thresholds.max_jump_px
    first, second, _ = find_jumps(
        points, watch.rejected_markers, 0.0, limit, thresholds.max_px_per_mm
    )
    return watch.rejected_frames > 0 and not (first or second)


@compiled
def monitor_markers(
    watch: MonitorState,
    first: bool,
    second: bool,
    crossed: bool,
    points: Floats,
    thresholds: Thresholds,
) -> None:
    """Count rejected frames, jumps and swaps of the markers with a new frame.

    Both markers have jumped only if their new positions agree from frame to frame: false detections
    do not agree.

    Parameters
    ----------
    watch : MonitorState
        State of the checks; updated.
    first, second : bool
        True if marker 1, marker 2 is far from its prediction.
    crossed : bool
        True if each marker is at the other's position.
    points : Floats
        Markers, (2, 2) raw px.
    thresholds : Thresholds
        Thresholds of the checks.
    """
    if not (first or second):
        watch.rejected_frames, watch.jumped_frames, watch.swapped_frames = 0, 0, 0
        return
    both = first and second
    steady = watch.rejected_frames == 0 or markers_stay(watch, points, thresholds)
    watch.rejected_frames += 1
    watch.jumped_frames = watch.jumped_frames + 1 if both and steady else (1 if both else 0)
    watch.swapped_frames = watch.swapped_frames + 1 if both and crossed else 0
    copy_into(watch.rejected_markers, points)


@compiled
def monitor_estimate(
    watch: MonitorState,
    p1: Floats,
    points: Floats,
    o_c: Floats,
    J_hat: Floats,
    thresholds: Thresholds,
) -> None:
    """Compare the estimate with the change of the features since the last comparison.

    Parameters
    ----------
    watch : MonitorState
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
    if all_finite(watch.compared_p1):
        motion, least, most = (
            subtract(p1, watch.compared_p1),
            thresholds.min_predicted_change,
            thresholds.max_change_error,
        )
        verdict = compare_with_estimate(
            points, watch.compared_markers, o_c, J_hat, motion, least, most
        )
        if verdict < 0:
            return
        watch.contradictions = watch.contradictions + 1 if verdict == 1 else 0
    copy_into(watch.compared_p1, p1)
    copy_into(watch.compared_markers, points)
