"""What the processes about a page share. Nobody waits for anybody.

page ─ wants, hand ─► servo process       page, STOP ─ bell ─► supervisor
     ◄─── ticks ────
     ◄─── said ───── servo process, supervisor     page ── changes ─► supervisor
"""

import pickle
import socket
import struct
from collections.abc import Iterator
from multiprocessing.context import BaseContext
from typing import Any

from rcmservo.live.shared_ring import SharedRing
from rcmservo.loop.tick import Tick
from rcmservo.page.jog_state import JogState
from rcmservo.recording.ros2_messages import encode_tick

TICK_SLOTS = 512
"""Number of ticks that the ring holds."""
MAX_TICK_BYTES = 4096
"""Largest tick in bytes."""
DUE_TIME = struct.Struct("<q")
"""Time in ns from the start of the loop at which a tick was due, at the end of its bytes."""

MAX_MESSAGE_BYTES = 1 << 16
"""Bytes of a message."""


class TickRing(SharedRing):
    """Newest ticks of a loop, each as a record holds it and followed by the time it was due."""

    def __init__(self, context: BaseContext) -> None:
        super().__init__(context, TICK_SLOTS, MAX_TICK_BYTES)

    def add(self, tick: Tick) -> None:
        """Add a tick as the newest."""
        self.put(encode_tick(tick), DUE_TIME.pack(tick.time))


class MessageChannel:
    """Messages one way, whole or not at all: many may put, one hears. There is room for a few, as a
    person has them. It is handed to a process when that is started.
    """

    def __init__(self) -> None:
        self._sender, self._receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sender.setblocking(False)
        self._receiver.setblocking(False)

    def put(self, message: object) -> bool:
        """Say something; whether there was room for it."""
        data = pickle.dumps(message)
        try:
            return self._sender.send(data) == len(data)
        except (BlockingIOError, OSError):
            return False

    def heard(self) -> Iterator[Any]:
        """What was said since."""
        while True:
            try:
                data = self._receiver.recv(MAX_MESSAGE_BYTES)
            except BlockingIOError:
                return
            yield pickle.loads(data)

    def fileno(self) -> int:
        """To wait for a message by."""
        return self._receiver.fileno()


class Desk:
    """All of it."""

    def __init__(self, context: BaseContext) -> None:
        self.ticks = TickRing(context)
        """What the loop does, tick by tick."""
        self.wants = MessageChannel()
        """What the person wants of the servo."""
        self.hand = JogState(context)
        """That the person is there, and which button is held."""
        self.said = MessageChannel()
        """What the servo process and the supervisor say to the person."""
        self.trouble = MessageChannel()
        """What is to go wrong with a simulated laboratory."""
        self.bell = MessageChannel()
        """What the supervisor is told: to stop, to clear."""
        self.changes = MessageChannel()
        """What it is told of settings, apart, so that they never fill the bell."""
