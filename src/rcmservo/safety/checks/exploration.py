"""Detectors of an exploration that cannot start or does not succeed."""

from rcmservo.control.exploration import is_overdue
from rcmservo.estimation.camera_fit_prediction import marker_order_score
from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import DetailFacts, TickFacts

MAX_SWAPPED_ORDER = -0.3
"""Value of `order` below which the markers count as swapped: 1 if correct, -1 if swapped."""


@compiled
def no_room_to_explore(facts: TickFacts) -> bool:
    """Detect joint limits that leave no room for the exploration."""
    return not facts.exploration_state.is_done and facts.exploration_state.has_no_room


@compiled
def exploration_failed(facts: TickFacts) -> bool:
    """Detect an exploration that takes too long although joint limits and images permit it."""
    hindered = (
        facts.exploration_state.is_done
        or facts.exploration_state.has_no_room
        or facts.monitor.image_frozen
    )
    return not hindered and is_overdue(
        facts.exploration_state, facts.observation.now, facts.exploration
    )


@compiled
def markers_are_in_reverse_order(facts: TickFacts) -> bool:
    """Return True if an exploration failed because the markers are swapped."""
    return exploration_failed(facts) and marker_order_score(facts.fit) < MAX_SWAPPED_ORDER


def advise(facts: DetailFacts) -> str:
    """Return the estimator's advice for the operator."""
    return facts.advice
