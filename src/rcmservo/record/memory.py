"""What a user's own estimator remembers at a tick, as a record keeps it: a message before the
tick's.

In columns it is the tick's ``memory`` (N, n), NaN at the ticks of estimators that keep less.
"""

import struct
from collections.abc import Mapping

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.loop.tick import Tick
from rcmservo.record.layout import header

TOPIC = "rcmservo/memory"
_START = struct.Struct("<20sI4x")
"""Header, how many numbers, and the padding before them."""


def numbers_of(tick: Tick) -> Floats | None:
    """What the estimator of a tick remembers (n,), or None where it keeps nothing."""
    return tick.servo.learner.remembered(tick.state.learnt.memory)


def encoded(now: int, numbers: Floats) -> bytes:
    """A message of the numbers (n,), stamped with a tick's moment."""
    return _START.pack(header(now), len(numbers)) + numbers.astype("<f8").tobytes()


def decoded(data: bytes) -> Floats:
    """The numbers (n,) in a message; ValueError where there are others than it says."""
    if len(data) < _START.size:
        raise ValueError("its message is too short")
    (_, count), numbers = _START.unpack_from(data), data[_START.size :]
    if len(numbers) != 8 * count:
        raise ValueError("it holds other numbers than it says")
    return np.frombuffer(numbers, "<f8")


def column(kept: Mapping[int, Floats], count: int) -> dict[str, Floats]:
    """The column of `count` ticks, of which some have kept something; no column where none has."""
    rows = {i: numbers for i, numbers in kept.items() if i < count}
    if not rows:
        return {}
    table = np.full((count, max(map(len, rows.values()))), np.nan)
    for i, numbers in rows.items():
        table[i, : len(numbers)] = numbers
    return {"memory": table}
