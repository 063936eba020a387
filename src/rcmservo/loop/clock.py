"""Ticks on an absolute schedule: the k-th tick is due at start + k/rate, however long the one
before took."""

import time
from array import array
from collections.abc import Iterator

from rcmservo.constraints import Limit, positive
from rcmservo.interfaces import Clock


def ticks(clock: Clock, rate: float = 100.0, duration: float = float("inf")) -> Iterator[int]:
    """Wait for each tick and yield its time in ns since the first, at `rate` Hz for `duration` s.

    A tick that is due when the one before is not done yet is skipped: there is never a burst to
    catch up.
    """
    positive("frequency in Hz").require("rate", rate)
    Limit(lambda s: s > 0.0, "a positive time in s").require("duration", duration)
    start = clock.now()
    k = 0
    while k < duration * rate:
        due = start + round(k * 1e9 / rate)
        clock.wait_until(due)
        yield due - start
        k = max(k + 1, int((clock.now() - start) * rate / 1e9) + 1)


class WallClock:
    """The time of this computer since it was started, which nobody sets: ns, the same for all of
    its processes."""

    def now(self) -> int:
        return time.monotonic_ns()

    def wait_until(self, time: int) -> None:
        sleep_until(time)


def sleep_until(moment: int) -> None:
    """Sleep until a `moment` in ns of the wall clock; not at all if it is past."""
    left = moment - time.monotonic_ns()
    if left > 0:
        time.sleep(left * 1e-9)


class Punctuality:
    """A clock that is asked through this one, and a note of how late (ns) each wait ended."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.lateness = array("q")

    def now(self) -> int:
        return self.clock.now()

    def wait_until(self, time: int) -> None:
        self.clock.wait_until(time)
        self.lateness.append(self.clock.now() - time)
