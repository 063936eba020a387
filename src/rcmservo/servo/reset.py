"""Resets of parts of the state: estimation, stall rule and requested motion.

The stall rule detects that the feature error no longer decreases.
"""

import numpy as np

from rcmservo.control.drive_response import reset_response
from rcmservo.interfaces import NEVER_NS
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, fill
from rcmservo.servo.state import Decision, StoredState


@compiled
def reset_estimation(stored: StoredState) -> None:
    """Reset estimate and exploration to the state before the first frame, with Ĵ = 0."""
    estimate, exploration = stored.estimate, stored.exploration_state
    fill(estimate.points, np.nan)
    fill(estimate.p1, np.nan)
    fill(estimate.o_c, np.nan)
    fill(estimate.o_c_covariance, np.nan)
    fill(estimate.y, np.nan)
    fill(estimate.delta, np.nan)
    fill(estimate.predicted_delta, np.nan)
    fill(estimate.J_hat, 0.0)
    fill(estimate.controlled_jacobian, 0.0)
    fill(estimate.controlled_error, 0.0)
    estimate.exposure, estimate.line_count = NEVER_NS, 0
    estimate.rcm_condition, estimate.condition = np.inf, np.inf
    fill(exploration.start_joints, 0.0)
    fill(exploration.sides, 0.0)
    fill(exploration.next_corner, 0.0)
    reset_response(exploration)
    exploration.visited_corners, exploration.start_time = 0, 0
    exploration.has_begun = exploration.has_no_room = False
    exploration.fit_is_known = exploration.is_done = False


@compiled
def reset_estimation_except_markers(stored: StoredState) -> None:
    """Reset the estimation but preserve the last accepted positions of the markers."""
    points, p1 = stored.estimate.points.copy(), stored.estimate.p1.copy()
    reset_estimation(stored)
    copy_into(stored.estimate.points, points)
    copy_into(stored.estimate.p1, p1)


@compiled
def restart_stall_rule(decision: Decision, now: int) -> None:
    """Restart the rule that an error must decrease within some time, counted from `now` ns."""
    decision.reference_error, decision.reference_time = np.inf, now


@compiled
def request_rest(decision: Decision) -> None:
    """Set the requested velocity and joint rates to zero."""
    fill(decision.v, 0.0)
    fill(decision.rates, 0.0)
