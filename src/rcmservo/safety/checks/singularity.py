"""Detectors of a singular estimated Jacobian between the tool and the target.

The control law inverts Ĵ with damping, eq. (31). The error that it can still reduce, as a fraction
(`reducible_fraction` of `ControllerOutput`), falls where Ĵ is nearly singular.
"""

from rcmservo.numerics.jit import compiled
from rcmservo.safety.checks.facts import TickFacts


@compiled
def path_is_singular(facts: TickFacts) -> bool:
    """Detect a singular surface across the path: the damped law reduces too little of the error."""
    return (
        facts.exploration_state.is_done
        and not facts.progress.reducible_fraction >= facts.thresholds.singular_fraction
    )


@compiled
def path_is_nearly_singular(facts: TickFacts) -> bool:
    """Detect a path that is nearly singular."""
    return (
        facts.exploration_state.is_done
        and not facts.progress.reducible_fraction >= facts.thresholds.nearly_singular_fraction
    )
