"""What is wrong with a controller's amplifiers, in words.

The data record has four bytes of it, of which the sources do not agree in what order they stand.
So they are asked for one by one. Of a peak current nothing is said: it is no fault.
Source: DMC-40x0 user manual, Amplifier Status; command reference, TA.
"""

from collections.abc import Sequence

from rcmservo.errors import told
from rcmservo.hardware.galil.data_record import LETTERS
from rcmservo.hardware.galil.wire import Conversation, Rejected
from rcmservo.live.lab import NotReady

ASKED = "MG _TA0,_TA1,_TA3"
"""Supply and heat of each half of the axes, hall sensors of each axis, the lock-out input of each
half."""

SUPPLY = "over-current", "over-voltage", "over-temperature", "under-voltage"
"""The bits of TA0, for the axes A to D; those for E to H are the next four."""

HALF = 4
"""Axes that share an amplifier."""


def asked(talk: Conversation, axes: str) -> list[str]:
    """What is wrong with the amplifiers of these axes, one sentence for each thing."""
    try:
        numbers = talk.numbers(ASKED)
    except Rejected:  # of a controller without amplifiers of its own
        return []
    return errors(numbers, axes)


def errors(numbers: Sequence[float], axes: str) -> list[str]:
    """What the answer to ASKED says of these axes, one sentence for each thing."""
    if len(numbers) != 3 or not all(0 <= number < 256 for number in numbers):
        raise NotReady(f"{ASKED} must tell three bytes, got {told(list(numbers))}")
    supply, halls, locked = (int(number) for number in numbers)
    found: list[str] = []
    for half in sorted({LETTERS.index(axis) // HALF for axis in axes}):
        which = f"axes {LETTERS[HALF * half]}-{LETTERS[HALF * half + HALF - 1]}"
        bits = supply >> len(SUPPLY) * half
        found += [f"{name} on {which}" for bit, name in enumerate(SUPPLY) if bits >> bit & 1]
        found += [f"electronic lock-out of {which}"] if locked >> half & 1 else []
    return found + [
        f"hall sensor error on axis {axis}" for axis in axes if halls >> LETTERS.index(axis) & 1
    ]
