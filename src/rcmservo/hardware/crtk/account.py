"""What an arm that speaks CRTK was sent."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CommandAccount:
    """What became of all commands that would move."""

    sent: int = 0
    """Those that went out to the arm."""
    withheld: int = 0
    """Those that were good and did not go out: the arm was not heard, or told a wild place, or
    nothing could be sent."""
    refused: int = 0
    """Those that were void: late, repeated, not finite, or with the drive off."""
    warned: int = 0
    """How often the arm warned: it refuses a command whole."""
    stale: int = 0
    """Words of the arm that could not be believed."""
