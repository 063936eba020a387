"""Recent joints of an arm, interpolated at the moment at which a camera saw it."""

from bisect import bisect_right
from collections import deque

import numpy as np

from rcmservo.interfaces import Floats


class JointHistory:
    """The newest `size` measurements of an arm's joints, in order of time.

    Plant, simulated arm and simulated camera ask it for the joints at an exposure. Two other
    interpolations are not this one: the compiled arm of a study keeps its joints in a ring that its
    kernels index by the step, and `rig check` shifts a whole motion by one lag, with `np.interp`.
    """

    def __init__(self, size: int) -> None:
        self._times: deque[int] = deque(maxlen=size)
        self._joints: deque[Floats] = deque(maxlen=size)

    def add(self, time: int, q: Floats) -> None:
        """Store the joints q (3,) at `time` ns, unless that is not later than the newest."""
        if not self._times or time > self._times[-1]:
            self._times.append(time)
            self._joints.append(q)

    def clear(self) -> None:
        """Forget all measurements."""
        self._times.clear()
        self._joints.clear()

    @property
    def oldest(self) -> float:
        """Time (ns) of the oldest measurement; inf where there is none."""
        return self._times[0] if self._times else np.inf

    def at(self, time: int) -> Floats:
        """Return the joints (3,) at `time` ns, linear between two measurements; the oldest or the
        newest measurement outside of them."""
        after = bisect_right(self._times, time)
        earlier = self._joints[max(after - 1, 0)]
        if after in (0, len(self._times)):
            return earlier
        began, end = self._times[after - 1], self._times[after]
        return earlier + (time - began) / (end - began) * (self._joints[after] - earlier)
