"""The hand of whoever has control: that it is there, and which jog button it holds down. What is
newest is what counts, so that nothing of it waits in a queue.
"""

import struct
import zlib
from multiprocessing.context import BaseContext
from typing import Any, NamedTuple

NONE = -1
LAYOUT = struct.Struct("<qqddd")
SUM = struct.Struct("<I")


class Gesture(NamedTuple):
    """What the hand does."""

    life: int = 0
    """It rises with each sign of life."""
    press: int = NONE
    """Which press of a button it is, NONE where none is held."""
    a: float = 0.0
    """rad/s of joint 1."""
    b: float = 0.0
    """rad/s of joint 2."""
    c: float = 0.0
    """mm/s of joint 3."""


class Hand:
    """Shared memory with the newest gesture: one writer. It is handed to a process when that is
    started."""

    def __init__(self, context: BaseContext) -> None:
        self._memory: Any = context.RawArray("B", LAYOUT.size + SUM.size)
        self._now = Gesture()
        self._write(self._now)

    def holds(self, press: int, rates: tuple[float, float, float]) -> None:
        """It is there, and holds a button down."""
        self._write(Gesture(self._now.life + 1, press, *rates))

    def beats(self) -> None:
        """It is there, and holds nothing."""
        self._write(Gesture(self._now.life + 1))

    def lets_go(self) -> None:
        """It holds nothing any more; that is no sign of life."""
        self._write(Gesture(self._now.life))

    def _write(self, gesture: Gesture) -> None:
        self._now = gesture
        data = LAYOUT.pack(*gesture)
        memoryview(self._memory).cast("B")[:] = data + SUM.pack(zlib.crc32(data))

    def read(self) -> Gesture | None:
        """The newest gesture; None while it is being written."""
        data = bytes(self._memory)
        body = data[: LAYOUT.size]
        whole = SUM.unpack(data[LAYOUT.size :])[0] == zlib.crc32(body)
        return Gesture(*LAYOUT.unpack(body)) if whole else None
