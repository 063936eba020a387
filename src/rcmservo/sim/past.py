"""The recent past of a simulated arm, for whatever sees the arm later than it moved."""

from collections import deque

from rcmservo.interfaces import Floats

KEPT = 1000
"""Steps of the physics that are kept."""


class Past:
    """The true joints of the last second, one entry for each ``step`` ns of the physics."""

    def __init__(self, step: int) -> None:
        self._step = step
        self._times: deque[int] = deque(maxlen=KEPT)
        self._joints: deque[Floats] = deque(maxlen=KEPT)

    def keep(self, time: int, q: Floats) -> None:
        """Remember that the joints were q (3,) at `time` ns."""
        self._times.append(time)
        self._joints.append(q)

    def forget(self) -> None:
        """Forget everything, as if the arm had not been there before."""
        self._times.clear()
        self._joints.clear()

    def joints_at(self, time: int) -> Floats:
        """The joints (3,) at a moment (ns) of the last second; before that, the oldest known."""
        back = min(max(-(-(self._times[-1] - time) // self._step), 0), len(self._times) - 1)
        earlier = self._joints[-1 - back]
        if back == 0 or time <= self._times[-1 - back]:
            return earlier
        share = (time - self._times[-1 - back]) / self._step
        return earlier + share * (self._joints[-back] - earlier)
