"""Detectors of an estimate that is unknown, out of bounds or contradicted by the frames."""

from rcmservo.control.saturated_controller import largest_scaled
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite
from rcmservo.safety.checks.facts import TickFacts
from rcmservo.safety.innovation import sound


@compiled
def estimator_failed(c: TickFacts) -> bool:
    """Detect the failure of a user's estimator."""
    return c.estimator_failed


@compiled
def estimate_is_not_finite(c: TickFacts) -> bool:
    """Detect a Ĵ that is not finite."""
    return not all_finite(c.estimate.J_hat)


@compiled
def rcm_is_unknown(c: TickFacts) -> bool:
    """Detect an imaged RCM that eq. (16) does not determine."""
    return c.tour.done and not c.estimate.rcm_condition <= c.max_rcm_condition


@compiled
def estimate_is_large(c: TickFacts) -> bool:
    """Detect a scaled Ĵ larger than that of any camera."""
    return c.tour.done and not largest_scaled(c.estimate.J_hat) <= c.thresholds.largest


@compiled
def estimate_diverged(c: TickFacts) -> bool:
    """Detect an estimate that frames contradict, or a fit that no camera explains."""
    contradicted = c.watch.wrong >= c.thresholds.disagreements
    return c.tour.done and (contradicted or not sound(c.prospect, c.thresholds))
