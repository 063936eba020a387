"""Recent joint values of an arm, interpolated at the exposure of a frame."""

from bisect import bisect_right
from collections import deque

import numpy as np

from rcmservo.interfaces import Floats


class JointHistory:
    """Newest `size` measurements of an arm's joints, in order of time.

    Plant, simulated arm and simulated camera interpolate the joints at an exposure in it. Two other
    places interpolate differently: the arm of a study (study/plant_kernel.py) stores the joints of
    each step of 1 ms in an array, and `rig check` (bringup/timing.py) shifts a whole motion by one
    lag with `np.interp`.
    """

    def __init__(self, size: int) -> None:
        self._times: deque[int] = deque(maxlen=size)
        self._joints: deque[Floats] = deque(maxlen=size)

    def add(self, time: int, q: Floats) -> None:
        """Store the joints q (3,) at `time` ns if that is later than the newest measurement."""
        if not self._times or time > self._times[-1]:
            self._times.append(time)
            self._joints.append(q)

    def clear(self) -> None:
        """Remove all measurements."""
        self._times.clear()
        self._joints.clear()

    @property
    def oldest(self) -> float:
        """Time (ns) of the oldest measurement; inf if there is none."""
        return self._times[0] if self._times else np.inf

    def at(self, time: int) -> Floats:
        """Return the joints (3,) at `time` ns by linear interpolation.

        Outside the measurements it is the oldest or the newest one.
        """
        after = bisect_right(self._times, time)
        earlier = self._joints[max(after - 1, 0)]
        if after in (0, len(self._times)):
            return earlier
        began, end = self._times[after - 1], self._times[after]
        return earlier + (time - began) / (end - began) * (self._joints[after] - earlier)
