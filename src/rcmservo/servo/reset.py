"""Resets of parts of the state: estimation, stall rule and requested motion."""

import numpy as np

from rcmservo.control.drive_lag import forget_lag
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, put
from rcmservo.servo.state import Decision, Stored


@compiled
def reset_estimation(stored: Stored) -> None:
    """Reset estimate and exploration to the state before the first frame, with Ĵ = 0."""
    estimate, tour = stored.estimate, stored.tour
    fill(estimate.points, np.nan)
    fill(estimate.p1, np.nan)
    fill(estimate.o_c, np.nan)
    fill(estimate.o_c_covariance, np.nan)
    fill(estimate.y, np.nan)
    fill(estimate.delta, np.nan)
    fill(estimate.ahead, np.nan)
    fill(estimate.J_hat, 0.0)
    fill(estimate.law_jacobian, 0.0)
    fill(estimate.law_error, 0.0)
    estimate.exposure, estimate.line_count = -1, 0
    estimate.rcm_condition, estimate.condition = np.inf, np.inf
    fill(tour.home, 0.0)
    fill(tour.sides, 0.0)
    fill(tour.goal, 0.0)
    forget_lag(tour)
    tour.visits, tour.start = 0, 0
    tour.begun, tour.no_room, tour.done = False, False, False


@compiled
def reset_estimation_except_markers(stored: Stored) -> None:
    """Reset the estimation but preserve the last accepted positions of the markers."""
    points, p1 = stored.estimate.points.copy(), stored.estimate.p1.copy()
    reset_estimation(stored)
    put(stored.estimate.points, points)
    put(stored.estimate.p1, p1)


@compiled
def restart_stall_rule(decision: Decision, now: int) -> None:
    """Restart the rule that detects a stall, counted from `now` ns."""
    decision.peak, decision.peak_time = np.inf, now


@compiled
def request_rest(decision: Decision) -> None:
    """Set the requested velocity and joint rates to zero."""
    fill(decision.v, 0.0)
    fill(decision.rates, 0.0)
