"""Acceptance of a new frame by comparison with the prediction of the projection fit."""

import numpy as np

from rcmservo.control.drive_lag import lag_of
from rcmservo.estimation.base import Estimate
from rcmservo.estimation.projection_prediction import deviation_without, located
from rcmservo.geometry.kinematics import point_at, reachable
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import distance, put
from rcmservo.safety.checks.drift import watch_drift, watch_stuck
from rcmservo.safety.innovation import leapt, lost, misplaced
from rcmservo.safety.monitor_state import (
    ObservationRow,
    Watch,
    stays,
    watch_frame,
    watch_loop,
    watch_markers,
)
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.kernel_parameters import KernelParameters, TickContext, rcm_of, shaft_of
from rcmservo.servo.state import Stored
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
    watch, estimate, fit = stored.watch, stored.estimate, stored.projection_fit
    tour, last = stored.tour, stored.decision.command
    thresholds, period = parameters.thresholds, parameters.period
    rcm, shaft = rcm_of(parameters), shaft_of(parameters)
    gap = observation.now - last.time if last.number > 0 else period
    watch_loop(watch, gap, period, lag_of(tour, thresholds.drive_lag), thresholds)
    if not observation.frame > watch.frame:
        return NO_FRAME, 0.0
    watch_frame(watch, observation, thresholds)
    if not reachable(rcm, observation.q_exposure, thresholds.slack):
        return NO_FRAME, 0.0
    p1, points = stored.workspace.p1, stored.workspace.points
    p1[0], p1[1], p1[2] = point_at(rcm, observation.q_exposure)
    put(points, observation.points)
    watch.spared = fill_lost_marker(stored, p1, points, parameters)
    first, second = lost(points)
    if first or second:
        return NO_FRAME, 0.0
    if tour.done:
        first, second, crossed = misplaced(fit, p1, points, estimate.points, shaft, thresholds)
        watch_markers(watch, first, second, crossed, points, thresholds)
        watch_drift(watch, fit, p1, points, observation.points, shaft, thresholds)
    else:
        jump = thresholds.jump + thresholds.innovation * np.sqrt(2.0 * fit.noise)
        check_against_last_frame(watch, estimate, observation, p1, jump, thresholds)
    if watch.rejected > 0:
        return NO_FRAME, 0.0
    watch.believed = observation.frame
    put(estimate.points, points)
    put(estimate.p1, p1)
    # an operator may have moved the tool by hand until the exploration began
    updates = tour.done or not tour.begun or observation.exposure >= tour.start
    frame_result = FRAME_UPDATES if updates else FRAME_ACCEPTED
    dt = (observation.exposure - estimate.exposure) * 1e-9 if estimate.exposure >= 0 else 0.0
    return frame_result, dt


@compiled
def fill_lost_marker(
    stored: Stored, p1: Floats, points: Floats, parameters: KernelParameters
) -> bool:
    """Replace one lost marker in the raw `points` (2, 2) px by its prediction from the fit.

    Return True if one marker was lost and replaced: the other marker and the joints then determine
    the pose well enough.
    """
    first, second = lost(points)
    if first == second or not (stored.tour.done and parameters.spares_marker):
        return False
    fit, k, shaft = stored.projection_fit, 0 if first else 1, shaft_of(parameters)
    if not deviation_without(fit, p1, k, shaft) <= parameters.thresholds.without_marker:
        return False
    put(points[k], located(fit, p1, shaft)[k])
    return True


@compiled
def check_against_last_frame(
    watch: Watch,
    estimate: Estimate,
    observation: ObservationRow,
    p1: Floats,
    jump: float,
    thresholds: Thresholds,
) -> None:
    """Compare the markers with those of the last accepted frame, before a fit predicts them.

    Count the frame as rejected if a marker moved by more than `jump` px plus the px that the motion
    of marker 1 to p1 (3,) mm allows, or if a marker is stuck.
    """
    path, crossed = distance(p1, estimate.p1), False
    first, second = watch_stuck(watch, p1, observation.points, thresholds)
    if path < thresholds.comparable and not (first or second):
        nearest = thresholds.nearest
        first, second, crossed = leapt(observation.points, estimate.points, path, jump, nearest)
        if watch.jumped > 0 and stays(watch, observation.points, thresholds):
            first, second = True, True
    watch_markers(watch, first, second, crossed, observation.points, thresholds)
