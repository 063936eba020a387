"""Actions of the page's buttons: those allowed in a phase, and those that recover from a cause."""

from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase


def list_recovery_actions(phase: Phase, cause: Cause) -> list[str]:
    """Return the actions that recover from a cause, in the order in which they are pressed."""
    if phase is Phase.FAULT:
        return ["clear"]
    if phase is not Phase.PAUSED:
        return []
    return ["teach_again", "resume"] if cause.needs_teaching else ["resume"]


def list_allowed_actions(phase: Phase) -> list[str]:
    """Return the actions that the browser in control may request in a phase of the loop."""
    if phase is Phase.FAULT:
        return ["clear"]
    paused, jog = phase is Phase.PAUSED, phase in (Phase.IDLE, Phase.PAUSED, Phase.JOG)
    return ["teach_again", "teach", "go", "resume" if paused else "pause", *["jog"] * jog]
