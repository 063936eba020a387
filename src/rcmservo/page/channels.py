"""Channels between the page's processes. No process waits for another one.

page ── requests, jog state ──► servo process
page ◄── ticks ──────────────── servo process
page ◄── status messages ────── servo process, supervisor
page ── settings changes ─────► supervisor
page, STOP ── stop requests ──► supervisor
"""

import pickle
import socket
import struct
from contextlib import suppress
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
"""Due time of a tick in ns from the start of the loop, at the end of the tick's bytes."""

MAX_MESSAGE_BYTES = 1 << 16
"""Largest message in bytes."""


class TickRing(SharedRing):
    """Shared-memory ring of a loop's newest ticks: bytes as in a record, then the due time."""

    def __init__(self, context: BaseContext) -> None:
        super().__init__(context, TICK_SLOTS, MAX_TICK_BYTES)

    def add(self, tick: Tick) -> None:
        """Add a tick as the newest."""
        self.put(encode_tick(tick), DUE_TIME.pack(tick.time))


class MessageChannel:
    """Channel in one direction with one receiver and any number of senders.

    A message arrives whole or not at all. The channel holds a few messages, enough for an operator.
    A process gets it as an argument when it is started.
    """

    def __init__(self) -> None:
        self._sender, self._receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sender.setblocking(False)
        self._receiver.setblocking(False)

    def send(self, message: object) -> bool:
        """Send a message. Return False if the channel is full."""
        data = pickle.dumps(message)
        try:
            return self._sender.send(data) == len(data)
        except OSError:  # includes BlockingIOError of a full channel
            return False

    def receive_all(self) -> list[Any]:
        """Return the messages that have arrived since the last call."""
        messages: list[Any] = []
        with suppress(BlockingIOError):
            while True:
                messages.append(pickle.loads(self._receiver.recv(MAX_MESSAGE_BYTES)))
        return messages

    def fileno(self) -> int:
        """Return the file descriptor to wait for a message."""
        return self._receiver.fileno()


class PageChannels:
    """All channels between the page's processes."""

    def __init__(self, context: BaseContext) -> None:
        self.ticks = TickRing(context)
        """Ticks of the loop."""
        self.requests = MessageChannel()
        """Requests of the operator to the servo."""
        self.jog_state = JogState(context)
        """Heartbeats and held jog button of the browser in control."""
        self.status = MessageChannel()
        """Status messages of the servo process and the supervisor to the page."""
        self.disturbances = MessageChannel()
        """Disturbances of a simulated laboratory."""
        self.stop_requests = MessageChannel()
        """Requests to the supervisor to stop and to clear a stop."""
        self.settings_changes = MessageChannel()
        """Settings to the supervisor, in their own channel, so that they never block a stop."""
