"""The way out of where the servo stands, as the buttons that take it."""

from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Phase

SHOW = "show the target again"
"""What a cause's way out says where the target must be shown anew."""


def ways(phase: Phase, cause: Cause) -> list[str]:
    """What the buttons say that lead on, in the order in which they are pressed."""
    if phase is Phase.FAULT:
        return ["clear"]
    if phase is not Phase.PAUSED:
        return []
    return ["show", "resume"] if SHOW in cause.way_out else ["resume"]
