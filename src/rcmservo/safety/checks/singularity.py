"""Detectors of a singular estimated Jacobian between the tool and the target.

The controller inverts Ĵ with damping, eq. (31). Where Ĵ is nearly singular, the damped inverse
reduces only a fraction of the feature error: `reducible_fraction` of `ControllerOutput`.
"""

from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import TickFacts


@compiled
def path_is_singular(facts: TickFacts) -> bool:
    """Detect a target at or beyond a singular surface: too little of the error is reducible."""
    is_reducible = facts.progress.reducible_fraction >= facts.thresholds.singular_fraction
    return facts.exploration_state.is_done and not is_reducible


@compiled
def path_is_nearly_singular(facts: TickFacts) -> bool:
    """Detect a nearly singular path, on which the tool must move slowly."""
    is_reducible = facts.progress.reducible_fraction >= facts.thresholds.nearly_singular_fraction
    return facts.exploration_state.is_done and not is_reducible
