"""Acceptance of a new frame: it is compared with what the fit of the projection predicts."""

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
from rcmservo.servo.update_estimate import BELIEVED, LEARN, NOTHING


@compiled
def accept_frame(tick: TickContext) -> tuple[int, float]:
    """Store what this tick's observation shows.

    Returns
    -------
    tuple
        NOTHING, BELIEVED for an accepted frame, or LEARN for one that the estimate is updated by;
        and the time since the exposure of the frame of the last update, s (0 for the first).
    """
    stored, observation, parameters = tick.stored, tick.observation, tick.parameters
    w, e, v, tour, d = stored.watch, stored.estimate, stored.prospect, stored.tour, stored.decision
    t, period = parameters.thresholds, parameters.period
    rcm, shaft = rcm_of(parameters), shaft_of(parameters)
    gap = observation.now - d.command.time if d.command.number > 0 else period
    watch_loop(w, gap, period, lag_of(tour, t.drive_lag), t)
    if not observation.frame > w.frame:
        return NOTHING, 0.0
    watch_frame(w, observation, t)
    if not reachable(rcm, observation.q_exposure, t.slack):
        return NOTHING, 0.0
    p1, points = stored.work.p1, stored.work.points
    p1[0], p1[1], p1[2] = point_at(rcm, observation.q_exposure)
    put(points, observation.points)
    w.spared = complete(stored, p1, points, parameters)
    first, second = lost(points)
    if first or second:
        return NOTHING, 0.0
    if tour.done:
        first, second, crossed = misplaced(v, p1, points, e.points, shaft, t)
        watch_markers(w, first, second, crossed, points, t)
        watch_drift(w, v, p1, points, observation.points, shaft, t)
    else:
        jump = t.jump + t.innovation * np.sqrt(2.0 * v.noise)
        doubt(w, e, observation, p1, jump, t)
    if w.rejected > 0:
        return NOTHING, 0.0
    w.believed = observation.frame
    put(e.points, points)
    put(e.p1, p1)
    # a hand may have moved the tool until the exploration began
    teaches = tour.done or not tour.begun or observation.exposure >= tour.start
    news = LEARN if teaches else BELIEVED
    return news, (observation.exposure - e.exposure) * 1e-9 if e.exposure >= 0 else 0.0


@compiled
def complete(stored: Stored, p1: Floats, points: Floats, parameters: KernelParameters) -> bool:
    """Put a lost one of the markers (2, 2) raw px where the fit has it; return whether one was
    lost, and the other and the joints determine the pose.
    """
    first, second = lost(points)
    if first == second or not (stored.tour.done and parameters.spares_marker):
        return False
    v, k, shaft = stored.prospect, 0 if first else 1, shaft_of(parameters)
    if not deviation_without(v, p1, k, shaft) <= parameters.thresholds.without_marker:
        return False
    put(points[k], located(v, p1, shaft)[k])
    return True


@compiled
def doubt(
    w: Watch, e: Estimate, observation: ObservationRow, p1: Floats, jump: float, t: Thresholds
) -> None:
    """While nothing predicts the markers: count a frame as rejected if they leapt by more than
    `jump` px and what the motion of the tool to p1 (3,) mm allows, or if one is stuck.
    """
    way, crossed = distance(p1, e.p1), False
    first, second = watch_stuck(w, p1, observation.points, t)
    if way < t.comparable and not (first or second):
        first, second, crossed = leapt(observation.points, e.points, way, jump, t.nearest)
        if w.jumped > 0 and stays(w, observation.points, t):
            first, second = True, True
    watch_markers(w, first, second, crossed, observation.points, t)
