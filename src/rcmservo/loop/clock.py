"""Clocks, and ticks on an absolute schedule: tick k is due at start + k/rate."""

import time
from array import array
from collections.abc import Iterator

from rcmservo.constraints import Limit, positive
from rcmservo.interfaces import Clock


def ticks(clock: Clock, rate: float = 100.0, duration: float = float("inf")) -> Iterator[int]:
    """Wait for each tick and yield its time.

    A tick that is due while the previous one still runs is skipped, so that ticks never come in a
    burst.

    Parameters
    ----------
    clock : Clock
        Clock of the plant.
    rate : float
        Ticks per second, Hz.
    duration : float
        Length of the schedule in s.

    Yields
    ------
    int
        Time in ns since the first tick.

    Raises
    ------
    BadInput
        If rate or duration is not positive.
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
    """Clock of the computer: time in ns since its start.

    It is the same in all processes and cannot be set.
    """

    def now(self) -> int:
        return time.monotonic_ns()

    def wait_until(self, time: int) -> None:
        sleep_until(time)


def sleep_until(moment: int) -> None:
    """Sleep until a `moment` in ns of the wall clock; return at once if it is past."""
    left = moment - time.monotonic_ns()
    if left > 0:
        time.sleep(left * 1e-9)


class RecordingClock:
    """Clock that records how late (ns) each wait of another clock ended."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.lateness = array("q")

    def now(self) -> int:
        return self.clock.now()

    def wait_until(self, time: int) -> None:
        self.clock.wait_until(time)
        self.lateness.append(self.clock.now() - time)
