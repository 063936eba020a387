"""Ticks from the loop to the page, in a ring of shared memory: as a record holds them, each
followed by the time at which it was due."""

import struct
from multiprocessing.context import BaseContext

from rcmservo.live.shared_ring import SharedRing
from rcmservo.loop.tick import Tick
from rcmservo.record.ros2_messages import encode_tick

SLOTS = 512
MAX_TICK = 4096
"""Bytes of a tick."""
DUE = struct.Struct("<q")
"""ns from the loop's start to when a tick was due, at the end of its bytes."""


class TickRing(SharedRing):
    """The newest ticks of a loop."""

    def __init__(self, context: BaseContext) -> None:
        super().__init__(context, SLOTS, MAX_TICK)

    def add(self, tick: Tick) -> None:
        """Add a tick as the newest."""
        self.put(encode_tick(tick), DUE.pack(tick.time))
