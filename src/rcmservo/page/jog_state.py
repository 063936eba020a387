"""Shared jog state of the browser in control: heartbeats and the jog button that is held down.

Only the newest state counts, so that no jog command waits in a queue.
"""

import struct
from multiprocessing.context import BaseContext
from typing import NamedTuple

from rcmservo.constraints import Triple
from rcmservo.live.shared_ring import SharedRing

NO_PRESS = -1
"""Number of the press while no button is held down."""
JOG_LAYOUT = struct.Struct("<qqdddd?")
"""Bytes of a `JogCommand`, in the order of its fields."""
JOG_SLOTS = 2
"""Number of commands in the ring, so that a reader finds one while the next is being written."""


class JogCommand(NamedTuple):
    """Jog command of the browser in control.

    Parameters
    ----------
    heartbeats : int
        Counter that rises with each sign of life.
    press : int
        Number of the press, `NO_PRESS` if no button is held down.
    first : float
        Rate of joint 1 in rad/s, or velocity along x in mm/s.
    second : float
        Rate of joint 2 in rad/s, or velocity along y in mm/s.
    third : float
        Rate of joint 3 in mm/s, or velocity along z in mm/s.
    speed_scale : float
        Fraction of the jog speed.
    moves_marker : bool
        The command moves marker 1 in the arm's base frame instead of joints.
    """

    heartbeats: int = 0
    press: int = NO_PRESS
    first: float = 0.0
    second: float = 0.0
    third: float = 0.0
    speed_scale: float = 1.0
    moves_marker: bool = False


class JogState:
    """Shared memory with the newest jog command. It has one writer.

    A process gets it as an argument when it is started.
    """

    def __init__(self, context: BaseContext) -> None:
        self.ring = SharedRing(context, JOG_SLOTS, JOG_LAYOUT.size)
        self._command = JogCommand()
        self._write(self._command)

    def hold(
        self, press: int, motion: Triple, speed_scale: float = 1.0, moves_marker: bool = False
    ) -> None:
        """Write that a button is held down; `motion` is joint rates or the velocity of marker 1."""
        heartbeats = self._command.heartbeats + 1
        self._write(JogCommand(heartbeats, press, *motion, speed_scale, moves_marker))

    def send_heartbeat(self) -> None:
        """Write a sign of life without a held button."""
        self._write(JogCommand(self._command.heartbeats + 1))

    def release(self) -> None:
        """Write that no button is held down. This is not a sign of life."""
        self._write(JogCommand(self._command.heartbeats))

    def _write(self, command: JogCommand) -> None:
        self._command = command
        self.ring.put(JOG_LAYOUT.pack(*command))

    def read(self) -> JogCommand | None:
        """Return the newest command; None if it is being overwritten or is damaged."""
        entry = self.ring.read(self.ring.newest)
        return JogCommand(*JOG_LAYOUT.unpack(entry.data)) if entry and entry.is_sound else None
