"""The way out of where the servo stands, as the buttons that take it."""

from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Phase


def ways(phase: Phase, cause: Cause) -> list[str]:
    """What the buttons say that lead on, in the order in which they are pressed."""
    if phase is Phase.FAULT:
        return ["clear"]
    if phase is not Phase.PAUSED:
        return []
    return ["show", "resume"] if cause.needs_teaching else ["resume"]
