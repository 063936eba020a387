"""Ticks from the loop to whoever looks at it: a ring in shared memory, one writer who never waits,
and readers who take what is there.

A tick is kept as its record keeps it, with the time at which it was due behind that. The writer
fills the oldest slot and only then says which is the newest; a reader copies a slot and looks
again, and a checksum catches what else went wrong.
"""

import struct
import zlib
from multiprocessing.context import BaseContext
from typing import Any

from rcmservo.loop.tick import Tick
from rcmservo.record import layout

SLOTS = 512
SIZE = 4096
"""Bytes of a slot."""
HEAD = struct.Struct("<qII")
"""Count of the tick in this ring, length of its bytes, and their checksum."""
DUE = struct.Struct("<q")
"""ns from the loop's start to when a tick was due, at the end of its bytes."""


class TickRing:
    """Room for the last ticks of a loop. It is handed to a process when that is started."""

    def __init__(self, context: BaseContext) -> None:
        self._memory: Any = context.RawArray("B", SLOTS * SIZE)
        self._newest: Any = context.RawValue("q", -1)

    @property
    def newest(self) -> int:
        """Count of the newest tick, -1 before the first."""
        return self._newest.value

    def _slot(self, count: int) -> memoryview:
        start = count % SLOTS * SIZE
        return memoryview(self._memory).cast("B")[start : start + SIZE]

    def put(self, tick: Tick) -> None:
        """Make a tick the newest."""
        data, count = layout.tick(tick) + DUE.pack(tick.time), self.newest + 1
        slot = self._slot(count)
        HEAD.pack_into(slot, 0, -1, 0, 0)
        slot[HEAD.size : HEAD.size + len(data)] = data
        HEAD.pack_into(slot, 0, count, len(data), zlib.crc32(data))
        self._newest.value = count

    def after(self, count: int) -> tuple[int, list[bytes]]:
        """The ticks after the `count`-th that are still there, and the count of the newest."""
        newest = self.newest
        found = (self._read(one) for one in range(max(count, newest - SLOTS) + 1, newest + 1))
        return newest, [data for data in found if data]

    def _read(self, count: int) -> bytes:
        """The bytes of a tick; empty where they are gone."""
        slot = self._slot(count)
        there, length, checksum = HEAD.unpack_from(slot)
        data = bytes(slot[HEAD.size : HEAD.size + length])
        return data if there == count and zlib.crc32(data) == checksum else b""
