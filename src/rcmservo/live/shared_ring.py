"""Ring of byte strings in shared memory: one writer that never waits, readers that copy and check.

The writer fills the oldest slot and only then publishes its number. A reader copies a slot and
checks its head again: an entry that changed meanwhile is not used, and a checksum reveals any other
damage. The memory has no name, so the system frees it when its processes end in any way.
"""

import struct
import zlib
from multiprocessing.context import BaseContext
from typing import Any, NamedTuple

HEAD = struct.Struct("<qII")
"""Number of an entry in its ring, length of its bytes, and their checksum (CRC-32)."""
EMPTY = -1
"""Number of the newest entry while there is none, and in the head of a slot while it is filled."""


class Entry(NamedTuple):
    """A copy of an entry.

    Parameters
    ----------
    data : bytes
        Bytes of the entry.
    is_sound : bool
        True if they are the bytes that were written, by their checksum.
    """

    data: bytes
    is_sound: bool


class SharedRing:
    """Newest entries of one writer, numbered from 0.

    A process receives the ring when it is started, not later.

    Parameters
    ----------
    context : BaseContext
        Start method of the processes that share the ring.
    slots : int
        Number of entries that the ring holds.
    size : int
        Largest length of an entry in bytes.
    """

    def __init__(self, context: BaseContext, slots: int, size: int) -> None:
        self._slot_count, self._slot_bytes = slots, HEAD.size + size
        self._memory: Any = context.RawArray("B", self._slot_count * self._slot_bytes)
        self._newest: Any = context.RawValue("q", EMPTY)

    @property
    def newest(self) -> int:
        """Number of the newest entry, `EMPTY` before the first."""
        return self._newest.value

    def slot(self, number: int) -> memoryview:
        """Return the memory of an entry."""
        start = number % self._slot_count * self._slot_bytes
        return memoryview(self._memory).cast("B")[start : start + self._slot_bytes]

    def put(self, *parts: bytes | memoryview) -> None:
        """Add the joined parts as the newest entry."""
        number, checksum, end = self.newest + 1, 0, HEAD.size
        slot = self.slot(number)
        HEAD.pack_into(slot, 0, EMPTY, 0, 0)
        for part in parts:
            slot[end : end + len(part)] = part
            checksum, end = zlib.crc32(part, checksum), end + len(part)
        HEAD.pack_into(slot, 0, number, end - HEAD.size, checksum)
        self._newest.value = number

    def read(self, number: int) -> Entry | None:
        """Return a copy of an entry; None if it is overwritten, or being written."""
        slot = self.slot(number)
        head = stored_number, length, checksum = HEAD.unpack_from(slot)
        data = bytes(slot[HEAD.size : HEAD.size + length])
        if stored_number != number or HEAD.unpack_from(slot) != head:
            return None
        return Entry(data, zlib.crc32(data) == checksum)

    def read_after(self, number: int) -> tuple[int, list[bytes]]:
        """Return the number of the newest entry, and the bytes of all sound ones after `number`."""
        newest = self.newest
        first = max(number, newest - self._slot_count) + 1
        entries = map(self.read, range(first, newest + 1))
        return newest, [entry.data for entry in entries if entry is not None and entry.is_sound]
