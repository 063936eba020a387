"""The hand of whoever has control: that it is there, and which jog button it holds down. What is
newest is what counts, so that nothing of it waits in a queue.
"""

import struct
from multiprocessing.context import BaseContext
from typing import NamedTuple

from rcmservo.constraints import Triple
from rcmservo.live.shared_ring import SharedRing

NONE = -1
LAYOUT = struct.Struct("<qqdddd?")
SLOTS = 2


class Gesture(NamedTuple):
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

    life: int = 0
    press: int = NONE
    a: float = 0.0
    b: float = 0.0
    c: float = 0.0
    share: float = 1.0
    leads: bool = False


class Hand:
    """Shared memory with the newest gesture: one writer. It is handed to a process when that is
    started.
    """

    def __init__(self, context: BaseContext) -> None:
        self.gestures = SharedRing(context, SLOTS, LAYOUT.size)
        self._now = Gesture()
        self._write(self._now)

    def holds(self, press: int, motion: Triple, share: float = 1.0, leads: bool = False) -> None:
        """It is there, and holds a button down that moves joints by their rates, or leads marker 1
        by its velocity.
        """
        self._write(Gesture(self._now.life + 1, press, *motion, share, leads))

    def beats(self) -> None:
        """It is there, and holds nothing."""
        self._write(Gesture(self._now.life + 1))

    def lets_go(self) -> None:
        """It holds nothing any more; that is no sign of life."""
        self._write(Gesture(self._now.life))

    def _write(self, gesture: Gesture) -> None:
        self._now = gesture
        self.gestures.put(LAYOUT.pack(*gesture))

    def read(self) -> Gesture | None:
        """The newest gesture; None if it is overwritten at this moment, or damaged."""
        entry = self.gestures.read(self.gestures.newest)
        return Gesture(*LAYOUT.unpack(entry.data)) if entry and entry.is_sound else None
