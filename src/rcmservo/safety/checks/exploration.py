"""Detectors of an exploration that cannot start or does not succeed.

The exploration is the first motion of a run: the tool moves around its start until the estimator
has an estimate of the camera.
"""

import numpy as np

from rcmservo.control.exploration import is_overdue
from rcmservo.estimation.camera_fit_prediction import compute_marker_order_score
from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import DetailFacts, TickFacts

MAX_SWAPPED_ORDER = -0.3
"""Value of `compute_marker_order_score` below which the markers count as swapped.

The score is about 1 if marker 1 is the one nearer the RCM, and about -1 if marker 2 is.
"""


@compiled
def no_room_to_explore(facts: TickFacts) -> bool:
    """Detect joint limits that leave no room for the exploration."""
    return not facts.exploration_state.is_done and facts.exploration_state.has_no_room


@compiled
def exploration_failed(facts: TickFacts) -> bool:
    """Detect an exploration that takes too long although joint limits and images permit it."""
    state = facts.exploration_state
    is_hindered = state.has_no_room or facts.monitor.image_frozen
    may_fail = not (state.is_done or is_hindered)
    return may_fail and is_overdue(state, facts.observation.now, facts.exploration)


@compiled
def markers_are_in_reverse_order(facts: TickFacts) -> bool:
    """Return True if an exploration failed because the markers are swapped."""
    return exploration_failed(facts) and compute_marker_order_score(facts.fit) < MAX_SWAPPED_ORDER


def describe_missing_estimate(facts: DetailFacts) -> str:
    """Return what the estimator lacked although the projection fit sufficed, and its advice."""
    difference, allowed = facts.disagreement, facts.exploration.tolerance
    if np.isnan(difference):
        return facts.advice
    lacking = (
        f"the estimated Jacobian differs by {difference:.0%}, instead of at most {allowed:.0%}, "
        "from that of the projection fit to the same frames"
        if difference < np.inf
        else "the frames do not determine the imaged RCM of eq. (16)"
    )
    return f"{lacking}; {facts.advice}" if facts.advice else lacking
