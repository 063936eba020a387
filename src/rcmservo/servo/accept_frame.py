"""Acceptance of a new frame by comparison with the prediction of the projection fit."""

import numpy as np

from rcmservo.control.drive_lag import known_or_measured_lag
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.camera_fit_prediction import deviation_without_marker, filter_markers
from rcmservo.geometry.kinematics import compute_position_tuple, is_within_limits
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_distance, copy_into
from rcmservo.safety.checks.drift import detect_stuck_markers, update_drift
from rcmservo.safety.innovation import find_deviating_markers, find_jumps, find_lost_markers
from rcmservo.safety.monitor_state import (
    MonitorState,
    ObservationRow,
    markers_stay,
    monitor_frame,
    monitor_loop,
    monitor_markers,
)
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    rcm_struct_of,
    tool_struct_of,
)
from rcmservo.servo.state import StoredState
from rcmservo.servo.update_estimate import FRAME_ACCEPTED, FRAME_UPDATES, NO_FRAME


@compiled
def accept_frame(tick: TickContext) -> tuple[int, float]:
    """Store the observation of this tick and decide if its frame is accepted.

    Returns
    -------
    tuple
        NO_FRAME, FRAME_ACCEPTED, or FRAME_UPDATES for an accepted frame that updates the estimate;
        time since the exposure of the frame of the last update, s (0 for the first).
    """
    stored, observation, parameters = tick.stored, tick.observation, tick.parameters
    monitor, estimate, fit = stored.monitor, stored.estimate, stored.projection_fit
    exploration, last = stored.exploration_state, stored.decision.command
    thresholds, period = parameters.thresholds, parameters.period
    rcm, shaft = rcm_struct_of(parameters), tool_struct_of(parameters)
    gap = observation.now - last.time if last.number > 0 else period
    lag = known_or_measured_lag(exploration, thresholds.drive_lag)
    monitor_loop(monitor, gap, period, lag, thresholds)
    if not observation.frame > monitor.newest_frame:
        return NO_FRAME, 0.0
    monitor_frame(monitor, observation, thresholds)
    if not is_within_limits(rcm, observation.q_exposure, thresholds.limit_tolerance):
        return NO_FRAME, 0.0
    p1, points = stored.workspace.p1, stored.workspace.points
    p1[0], p1[1], p1[2] = compute_position_tuple(rcm, observation.q_exposure)
    copy_into(points, observation.points)
    monitor.one_marker_suffices = fill_lost_marker(stored, p1, points, parameters)
    first, second = find_lost_markers(points)
    if first or second:
        return NO_FRAME, 0.0
    if exploration.is_done:
        first, second, crossed = find_deviating_markers(
            fit, p1, points, estimate.points, shaft, thresholds
        )
        monitor_markers(monitor, first, second, crossed, points, thresholds)
        update_drift(monitor, fit, p1, points, observation.points, shaft, thresholds)
    else:
        jump = thresholds.max_jump_px + thresholds.max_innovation * np.sqrt(
            2.0 * fit.noise_variance
        )
        check_against_last_frame(monitor, estimate, observation, p1, jump, thresholds)
    if monitor.rejected_frames > 0:
        return NO_FRAME, 0.0
    monitor.accepted_frame = observation.frame
    copy_into(estimate.points, points)
    copy_into(estimate.p1, p1)
    # an operator may have moved the tool by hand until the exploration began
    updates = (
        exploration.is_done
        or not exploration.has_begun
        or observation.exposure >= exploration.start_time
    )
    frame_result = FRAME_UPDATES if updates else FRAME_ACCEPTED
    dt = (observation.exposure - estimate.exposure) * 1e-9 if estimate.exposure >= 0 else 0.0
    return frame_result, dt


@compiled
def fill_lost_marker(
    stored: StoredState, p1: Floats, points: Floats, parameters: KernelParameters
) -> bool:
    """Replace one lost marker in the raw `points` (2, 2) px by its prediction from the fit.

    Return True if one marker was lost and replaced: the other marker and the joints then determine
    the pose well enough.
    """
    first, second = find_lost_markers(points)
    if first == second or not (
        stored.exploration_state.is_done and parameters.tolerates_lost_marker
    ):
        return False
    fit, k, shaft = stored.projection_fit, 0 if first else 1, tool_struct_of(parameters)
    if (
        not deviation_without_marker(fit, p1, k, shaft)
        <= parameters.thresholds.max_single_marker_deviation
    ):
        return False
    copy_into(points[k], filter_markers(fit, p1, shaft)[k])
    return True


@compiled
def check_against_last_frame(
    monitor: MonitorState,
    estimate: Estimate,
    observation: ObservationRow,
    p1: Floats,
    jump: float,
    thresholds: Thresholds,
) -> None:
    """Compare the markers with those of the last accepted frame, before a fit predicts them.

    Count the frame as rejected if a marker moved by more than `max_jump_px` px plus the px that the
    motion of marker 1 to p1 (3,) mm allows, or if a marker is stuck.
    """
    path, crossed = compute_distance(p1, estimate.p1), False
    first, second = detect_stuck_markers(monitor, p1, observation.points, thresholds)
    if path < thresholds.max_compared_motion and not (first or second):
        nearest = thresholds.max_px_per_mm
        first, second, crossed = find_jumps(
            observation.points, estimate.points, path, jump, nearest
        )
        if monitor.jumped_frames > 0 and markers_stay(monitor, observation.points, thresholds):
            first, second = True, True
    monitor_markers(monitor, first, second, crossed, observation.points, thresholds)
