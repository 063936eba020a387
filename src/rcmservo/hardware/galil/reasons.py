"""Why the controller switched the motors off, or does not begin, in words."""

from collections.abc import Sequence

from rcmservo.errors import told as words
from rcmservo.hardware.galil import amplifier
from rcmservo.hardware.galil import watchdog_program as program
from rcmservo.hardware.galil.codes import ERRORS, STOPS
from rcmservo.hardware.galil.wire import Conversation

TOLD_TO = 0, 4
"""Stop codes of axes that move, or stand as they were told to."""


def refused(talk: Conversation) -> str:
    """What was refused last, also to the program, since TC was asked; empty where nothing was."""
    code = int(talk.number("_TC"))
    return ERRORS.get(code, f"error {code}") if code else ""


def stopped(talk: Conversation, axes: str, stops: Sequence[int]) -> str:
    """What stopped these axes that stand by these stop codes, as the watchdog program says, or the
    axes do."""
    why = int(talk.known("why"))
    if why in program.WHYS and why != program.RESTING:
        return program.WHYS[why]
    found = [
        f"axis {axis} {STOPS.get(stop, 'stands for a reason without a name')}"
        for axis, stop in zip(axes, stops, strict=True)
        if stop not in TOLD_TO
    ]
    return "; ".join(found) or program.WHYS.get(why, "") or refused(talk) or "the motors went off"


def told(cause: str, talk: Conversation, axes: str, said: str) -> str:
    """A cause in a sentence, with what is wrong with the amplifiers of the axes, and what the
    controller said of its own accord."""
    parts = [cause, *amplifier.asked(talk, axes)]
    return "; ".join([*parts, f"it said {words(said)}"] if said else parts)
