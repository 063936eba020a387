"""The buttons that may be pressed in a phase, and those that lead out of a cause."""

from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase


def list_recovery_actions(phase: Phase, cause: Cause) -> list[str]:
    """What the buttons say that lead on, in the order in which they are pressed."""
    if phase is Phase.FAULT:
        return ["clear"]
    if phase is not Phase.PAUSED:
        return []
    return ["show", "resume"] if cause.needs_teaching else ["resume"]


def list_allowed_actions(phase: Phase) -> list[str]:
    """Return the actions that the browser in control may ask for in a phase of the loop."""
    if phase is Phase.FAULT:
        return ["clear"]
    paused, jog = phase is Phase.PAUSED, phase in (Phase.IDLE, Phase.PAUSED, Phase.JOG)
    return ["show", "teach", "go", "resume" if paused else "pause", *["jog"] * jog]
