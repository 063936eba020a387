"""The recent past of a simulated arm, for whatever sees the arm later than it moved."""

from collections import deque

from rcmservo.interfaces import Floats

KEPT = 1000
"""Steps of the physics that are kept."""


class Past:
    """What the joints were in the last second, one entry for each ``step`` ns of the physics."""

    def __init__(self, step: int) -> None:
        self._step = step
        self._times: deque[int] = deque(maxlen=KEPT)
        self._joints: deque[Floats] = deque(maxlen=KEPT)

    def keep(self, time: int, q: Floats) -> None:
        """Remember that the joints were q at `time` ns."""
        self._times.append(time)
        self._joints.append(q)

    def forget(self) -> None:
        """Forget everything, as if the arm had not been there before."""
        self._times.clear()
        self._joints.clear()

    def at(self, time: int) -> tuple[Floats, Floats, float]:
        """The entries before and after a moment (ns) of the last second, and how far between them
        it is, from 0 to 1.

        Before that second it is the oldest that is known.
        """
        back = min(max(-(-(self._times[-1] - time) // self._step), 0), len(self._times) - 1)
        earlier, began = self._joints[-1 - back], self._times[-1 - back]
        if back == 0 or time <= began:
            return earlier, earlier, 0.0
        return earlier, self._joints[-back], (time - began) / self._step
