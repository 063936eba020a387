"""Detectors of an estimate that is unknown, out of bounds or contradicted by frames.

The estimate is the Jacobian Ĵ of the features with respect to the motion of marker 1, and the
imaged RCM. Every comparison is written so that NaN triggers the cause.
"""

from rcmservo.control.saturated_controller import find_max_scaled_entry
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.innovation import is_plausible_fit


@compiled
def estimator_failed(facts: TickFacts) -> bool:
    """Detect an error that a user-defined estimator raised."""
    return facts.estimator_failed


@compiled
def estimate_is_not_finite(facts: TickFacts) -> bool:
    """Detect an estimated Jacobian Ĵ that is not finite."""
    return not all_finite(facts.estimate.J_hat)


@compiled
def rcm_is_unknown(facts: TickFacts) -> bool:
    """Detect an imaged RCM that eq. (16) does not determine."""
    return facts.exploration_state.is_done and not facts.estimate.rcm_uncertainty <= 1.0


@compiled
def estimate_is_large(facts: TickFacts) -> bool:
    """Detect a scaled Ĵ with entries larger than those of any camera."""
    is_possible = find_max_scaled_entry(facts.estimate.J_hat) <= facts.thresholds.max_jacobian_entry
    return facts.exploration_state.is_done and not is_possible


@compiled
def estimate_diverged(facts: TickFacts) -> bool:
    """Detect an estimate that frames contradict, or a fit that is no camera's projection."""
    thresholds = facts.thresholds
    is_contradicted = facts.monitor.contradictions >= thresholds.max_contradictions
    has_diverged = is_contradicted or not is_plausible_fit(facts.fit, thresholds)
    return facts.exploration_state.is_done and has_diverged
