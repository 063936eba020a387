"""Recent joint values of an arm, interpolated at the exposure of a frame."""

from bisect import bisect_right
from collections import deque

import numpy as np

from rcmservo.interfaces import Floats


class JointHistory:
    """Newest `size` measurements of an arm's joints, in order of time.

    Parameters
    ----------
    size : int
        Number of measurements that are stored; older ones are dropped.

    Notes
    -----
    Plant, simulated arm and simulated camera interpolate the joints at an exposure with it. Two
    other places differ for a reason: a study stores the joints of each step of 1 ms in an array
    (study/plant_kernel.py), and `rig check` shifts a whole motion by one lag with `np.interp`
    (bringup/timing.py).
    """

    def __init__(self, size: int) -> None:
        self._times_ns: deque[int] = deque(maxlen=size)
        self._joints: deque[Floats] = deque(maxlen=size)

    def add(self, time: int, q: Floats) -> None:
        """Store the joints q (3,) at `time` ns if that is later than the newest measurement."""
        if not self._times_ns or time > self._times_ns[-1]:
            self._times_ns.append(time)
            self._joints.append(q)

    def clear(self) -> None:
        """Remove all measurements."""
        self._times_ns.clear()
        self._joints.clear()

    @property
    def oldest(self) -> float:
        """Time (ns) of the oldest measurement; inf if there is none."""
        return self._times_ns[0] if self._times_ns else np.inf

    def interpolate(self, time: int) -> Floats:
        """Return the joints (3,) at `time` ns by linear interpolation.

        Before the oldest measurement they are those of the oldest, after the newest those of the
        newest.
        """
        after = bisect_right(self._times_ns, time)
        before = max(after - 1, 0)
        if after in (0, len(self._times_ns)):
            return self._joints[before]
        q_before, q_after = self._joints[before], self._joints[after]
        time_before, time_after = self._times_ns[before], self._times_ns[after]
        return q_before + (time - time_before) / (time_after - time_before) * (q_after - q_before)
