"""What the processes about a page share. Nobody waits for anybody.

page ─ wants, hand ─► servo process       page, STOP ─ bell ─► supervisor
     ◄─── ticks ────
     ◄─── said ───── servo process, supervisor     page ── changes ─► supervisor
"""

import pickle
import socket
from collections.abc import Iterator
from multiprocessing.context import BaseContext
from typing import Any

from rcmservo.page.hand import Hand
from rcmservo.page.tick_ring import TickRing

LARGEST = 1 << 16
"""Bytes of a message."""


class Post:
    """Messages one way, whole or not at all: many may put, one hears. There is room for a few, as a
    person has them. It is handed to a process when that is started."""

    def __init__(self) -> None:
        self._mouth, self._ear = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._mouth.setblocking(False)
        self._ear.setblocking(False)

    def put(self, message: object) -> bool:
        """Say something; whether there was room for it."""
        data = pickle.dumps(message)
        try:
            return self._mouth.send(data) == len(data)
        except (BlockingIOError, OSError):
            return False

    def heard(self) -> Iterator[Any]:
        """What was said since."""
        while True:
            try:
                data = self._ear.recv(LARGEST)
            except BlockingIOError:
                return
            yield pickle.loads(data)

    def fileno(self) -> int:
        """To wait for a message by."""
        return self._ear.fileno()


class Desk:
    """All of it."""

    def __init__(self, context: BaseContext) -> None:
        self.ticks = TickRing(context)
        """What the loop does, tick by tick."""
        self.wants = Post()
        """What the person wants of the servo."""
        self.hand = Hand(context)
        """That the person is there, and which button is held."""
        self.said = Post()
        """What the servo process and the supervisor say to the person."""
        self.trouble = Post()
        """What is to go wrong with a simulated laboratory."""
        self.bell = Post()
        """What the supervisor is told: to stop, to clear."""
        self.changes = Post()
        """What it is told of settings, apart, so that they never fill the bell."""
