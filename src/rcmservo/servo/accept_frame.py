"""Acceptance of a new frame by comparison with the prediction of the projection fit.

A frame is one exposure of the camera with both markers. A rejected frame changes no estimate.
"""

import numpy as np

from rcmservo.estimation.base import Estimate
from rcmservo.estimation.camera_fit_prediction import (
    compute_deviation_without_marker,
    filter_markers,
)
from rcmservo.geometry.kinematics import compute_position_tuple, is_within_limits
from rcmservo.interfaces import NEVER_NS, Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_distance, copy_into
from rcmservo.safety.checks.drift import detect_still_markers, update_drift
from rcmservo.safety.checks.repeated_frames import detect_repeated_frame
from rcmservo.safety.innovation import find_deviating_markers, find_jumps, find_lost_markers
from rcmservo.safety.monitor_state import (
    MonitorState,
    ObservationRow,
    markers_stay,
    monitor_frame,
    monitor_loop,
    monitor_markers,
)
from rcmservo.safety.state_machine import SERVO
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import (
    KernelParameters,
    TickContext,
    make_rcm_struct,
    make_tool_struct,
)
from rcmservo.servo.state import StoredState
from rcmservo.servo.update_estimate import FRAME_ACCEPTED, FRAME_UPDATES, NO_FRAME


@compiled
def accept_frame(tick: TickContext) -> tuple[int, float]:
    """Decide if the frame of this tick is accepted, and count rejected frames.

    The frame is compared with the prediction of the projection fit, or before exploration has ended
    with the last accepted frame.

    Returns
    -------
    tuple
        NO_FRAME, FRAME_ACCEPTED, or FRAME_UPDATES for an accepted frame that updates the estimate;
        time since the exposure of the frame of the last update, s (0 for the first).
    """
    stored, observation, parameters = tick.stored, tick.observation, tick.parameters
    monitor, estimate, fit = stored.monitor, stored.estimate, stored.projection_fit
    exploration, command = stored.exploration_state, stored.decision.command
    thresholds, period = parameters.thresholds, parameters.period
    rcm, shaft = make_rcm_struct(parameters), make_tool_struct(parameters)
    gap_ns = observation.now - command.time if command.number > 0 else period
    is_servoing = stored.decision.mode.phase == SERVO
    monitor_loop(monitor, gap_ns, period, exploration, is_servoing, thresholds)
    if not observation.frame > monitor.newest_frame:
        return NO_FRAME, 0.0
    p1, points = stored.workspace.p1, stored.workspace.points
    p1[0], p1[1], p1[2] = compute_position_tuple(rcm, observation.q_exposure)
    copy_into(points, observation.points)
    if detect_repeated_frame(monitor, fit, exploration.is_done, p1, points, shaft, thresholds):
        monitor.newest_frame = observation.frame
        return NO_FRAME, 0.0
    monitor_frame(monitor, observation, thresholds)
    if not is_complete(tick, p1, points):
        return NO_FRAME, 0.0
    if exploration.is_done:
        deviates_1, deviates_2, crossed = find_deviating_markers(
            fit, p1, points, estimate.points, shaft, thresholds
        )
        monitor_markers(
            monitor, deviates_1, deviates_2, crossed, points, estimate.points, thresholds
        )
        if not crossed:  # its residual has the same direction each time, as that of a drift
            has_arrived = stored.decision.has_arrived
            update_drift(monitor, fit, p1, points, shaft, has_arrived, thresholds)
    else:
        noise_px = np.sqrt(2.0 * fit.noise_variance)
        max_jump_px = thresholds.max_jump_px + thresholds.max_innovation * noise_px
        is_exploring = exploration.has_begun
        check_against_last_frame(
            monitor, estimate, observation, p1, max_jump_px, is_exploring, thresholds
        )
    if monitor.rejected_frames > 0:
        return NO_FRAME, 0.0
    monitor.accepted_frame = observation.frame
    copy_into(estimate.points, points)
    copy_into(estimate.p1, p1)
    is_first = estimate.exposure == NEVER_NS
    dt = 0.0 if is_first else (observation.exposure - estimate.exposure) * 1e-9
    # a frame from before the exploration: an operator may have moved the tool by hand since
    is_exploring = exploration.has_begun and not exploration.is_done
    if is_exploring and observation.exposure < exploration.start_time:
        return FRAME_ACCEPTED, dt
    return FRAME_UPDATES, dt


@compiled
def is_complete(tick: TickContext, p1: Floats, points: Floats) -> bool:
    """Return True if the joints (3,) and both markers (2, 2) px of a frame are known.

    A lost marker is replaced where the other one and the joints determine the pose.
    """
    observation, parameters = tick.observation, tick.parameters
    tolerance = parameters.thresholds.limit_tolerance
    if not is_within_limits(make_rcm_struct(parameters), observation.q_exposure, tolerance):
        return False
    suffices = fill_lost_marker(tick.stored, p1, points, parameters)
    tick.stored.monitor.one_marker_suffices = suffices
    lost_1, lost_2 = find_lost_markers(points)
    return not (lost_1 or lost_2)


@compiled
def fill_lost_marker(
    stored: StoredState, p1: Floats, points: Floats, parameters: KernelParameters
) -> bool:
    """Replace one lost marker in the raw `points` (2, 2) px by its prediction from the fit.

    Return True if one marker was lost and replaced: the other marker and the joints then determine
    the pose well enough.
    """
    lost_1, lost_2 = find_lost_markers(points)
    can_predict = stored.exploration_state.is_done and parameters.tolerates_lost_marker
    if lost_1 == lost_2 or not can_predict:
        return False
    fit, k, shaft = stored.projection_fit, 0 if lost_1 else 1, make_tool_struct(parameters)
    deviation_mm = compute_deviation_without_marker(fit, p1, k, shaft)
    if not deviation_mm <= parameters.thresholds.max_single_marker_deviation:
        return False
    copy_into(points[k], filter_markers(fit, p1, shaft)[k])
    return True


@compiled
def check_against_last_frame(
    monitor: MonitorState,
    estimate: Estimate,
    observation: ObservationRow,
    p1: Floats,
    max_jump_px: float,
    is_exploring: bool,
    thresholds: Thresholds,
) -> None:
    """Compare the markers with those of the last accepted frame, before a fit predicts them.

    Count the frame as rejected if a marker moved by more than `max_jump_px` plus the pixels that
    the motion of marker 1 to p1 (3,) mm allows, or if a marker does not move with the tool. A frame
    that jumped says nothing about that.
    """
    points, distance_mm = observation.points, compute_distance(p1, estimate.p1)
    rejects_1, rejects_2, crossed = False, False, False
    if distance_mm < thresholds.max_compared_motion:
        rejects_1, rejects_2, crossed = find_jumps(
            points, estimate.points, distance_mm, max_jump_px, thresholds.max_px_per_mm
        )
        if monitor.jumped_frames > 0 and markers_stay(monitor, points, thresholds):
            rejects_1, rejects_2 = True, True
        if (
            monitor.agreeing_frames == 1
            and monitor.rejected_frames > 0
            and (rejects_1 or rejects_2)
        ):
            max_px_per_mm, others = thresholds.max_px_per_mm, monitor.rejected_markers
            jumps = find_jumps(points, others, distance_mm, max_jump_px, max_px_per_mm)
            monitor.first_frame_is_wrong = not (jumps[0] or jumps[1])
    if not (rejects_1 or rejects_2):
        rejects_1, rejects_2 = detect_still_markers(monitor, p1, points, is_exploring, thresholds)
    accepted = estimate.points
    monitor_markers(monitor, rejects_1, rejects_2, crossed, points, accepted, thresholds)
    if monitor.rejected_frames == 0:
        monitor.agreeing_frames += 1
