"""The hand of whoever has control: that it is there, and which jog button it holds down. What is
newest is what counts, so that nothing of it waits in a queue.
"""

import struct
from multiprocessing.context import BaseContext
from typing import NamedTuple

from rcmservo.constraints import Triple
from rcmservo.live.shared_ring import SharedRing

NO_PRESS = -1
JOG_LAYOUT = struct.Struct("<qqdddd?")
JOG_SLOTS = 2


class JogCommand(NamedTuple):
    """What the hand does.

    Parameters
    ----------
    life : int
        It rises with each sign of life.
    press : int
        Which press of a button it is, NONE where none is held.
    a : float
        rad/s of joint 1, or mm/s along x.
    b : float
        rad/s of joint 2, or mm/s along y.
    c : float
        mm/s of joint 3, or along z.
    share : float
        Of the speed that a jog may have.
    leads : bool
        Whether the button leads marker 1 in the arm's base frame, and no single joint.
    """

    heartbeats: int = 0
    press: int = NO_PRESS
    first: float = 0.0
    second: float = 0.0
    third: float = 0.0
    speed_scale: float = 1.0
    moves_marker: bool = False


class JogState:
    """Shared memory with the newest gesture: one writer. It is handed to a process when that is
    started.
    """

    def __init__(self, context: BaseContext) -> None:
        self.ring = SharedRing(context, JOG_SLOTS, JOG_LAYOUT.size)
        self._command = JogCommand()
        self._write(self._command)

    def hold(
        self, press: int, motion: Triple, speed_scale: float = 1.0, moves_marker: bool = False
    ) -> None:
        """It is there, and holds a button down that moves joints by their rates, or leads marker 1
        by its velocity.
        """
        self._write(
            JogCommand(self._command.heartbeats + 1, press, *motion, speed_scale, moves_marker)
        )

    def send_heartbeat(self) -> None:
        """It is there, and holds nothing."""
        self._write(JogCommand(self._command.heartbeats + 1))

    def release(self) -> None:
        """It holds nothing any more; that is no sign of life."""
        self._write(JogCommand(self._command.heartbeats))

    def _write(self, command: JogCommand) -> None:
        self._command = command
        self.ring.put(JOG_LAYOUT.pack(*command))

    def read(self) -> JogCommand | None:
        """The newest gesture; None if it is overwritten at this moment, or damaged."""
        entry = self.ring.read(self.ring.newest)
        return JogCommand(*JOG_LAYOUT.unpack(entry.data)) if entry and entry.is_sound else None
