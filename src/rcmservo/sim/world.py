"""Simulated time: the arm moves while somebody waits, and its recent past is kept for what sees it
later."""

from collections import deque
from collections.abc import Callable

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.arm import STEP, SimulatedArm

HISTORY = 1000


class World:
    """The clock of a simulated plant, and the true joints of the last second.

    ``stalls`` tells until when a wait really lasts, where the waiting process is held up.
    """

    def __init__(self, arm: SimulatedArm) -> None:
        self.arm = arm
        self.stalls: Callable[[int], int] | None = None
        self._times: deque[int] = deque(maxlen=HISTORY)
        self._joints: deque[Floats] = deque(maxlen=HISTORY)
        self._keep()

    def now(self) -> int:
        return self.arm.time

    def wait_until(self, time: int) -> None:
        self.pass_until(time if self.stalls is None else self.stalls(time))

    def pass_until(self, time: int) -> None:
        """Let time pass, whoever may wait or not."""
        while self.arm.time + STEP // 2 < time:
            self.arm.advance()
            self._keep()

    def place(self, q: Floats) -> None:
        """Put the arm at q (3,) and act as if it had always been there."""
        self.arm.place(q)
        self._times.clear()
        self._joints.clear()
        self._keep()

    def joints_at(self, time: int) -> Floats:
        """The true joints (3,) at a moment of the last second; the oldest known before that."""
        back = min(max(-(-(self._times[-1] - time) // STEP), 0), len(self._times) - 1)
        earlier = self._joints[-1 - back]
        if back == 0 or time <= self._times[-1 - back]:
            return earlier
        share = (time - self._times[-1 - back]) / STEP
        return earlier + share * (self._joints[-back] - earlier)

    def _keep(self) -> None:
        self._times.append(self.arm.time)
        self._joints.append(self.arm.q_true)


def moments(middle: int, length: float, count: int) -> list[int]:
    """`count` moments (ns) spread evenly over an exposure of `length` s about its middle."""
    return [
        middle + round(share * length * 1e9) for share in (np.arange(count) + 0.5) / count - 0.5
    ]
