"""Clocks, and the ticks of a loop on an absolute schedule: tick k is due at start + k/rate."""

import time
from array import array
from collections.abc import Iterator

from rcmservo.constraints import Limit, positive
from rcmservo.interfaces import Clock

DURATION = Limit(lambda duration: duration > 0.0, "a positive time in s")
"""Range of the length of a run."""


def ticks(clock: Clock, rate: float = 100.0, duration: float = float("inf")) -> Iterator[int]:
    """Wait until each tick is due and yield its time.

    Tick k is due at start + k/rate. Ticks that become due while the caller works on an earlier one
    are skipped, so that ticks never come in a burst.

    Parameters
    ----------
    clock : Clock
        Clock of the plant.
    rate : float
        Ticks per second, Hz; positive and finite.
    duration : float
        Length of the schedule in s, positive; infinite by default.

    Yields
    ------
    int
        Time in ns since the first tick.

    Raises
    ------
    BadInput
        If the rate is not positive and finite, or the duration is not positive.
    """
    positive("frequency in Hz").require("rate", rate)
    DURATION.require("duration", duration)
    start = clock.now()
    k = 0
    while k < duration * rate:
        due = start + round(k * 1e9 / rate)
        clock.wait_until(due)
        yield due - start
        k = max(k + 1, int((clock.now() - start) * rate / 1e9) + 1)


class WallClock:
    """Monotonic clock of the computer, in ns.

    It is the same in all processes of the computer, and nobody can set it. Its zero is arbitrary.
    It is the `Clock` of a `Plant` on hardware, where time passes by itself.
    """

    def now(self) -> int:
        """Return the present time in ns."""
        return time.monotonic_ns()

    def wait_until(self, time: int) -> None:
        """Sleep until `time` in ns; return at once if it is past."""
        sleep_until(time)


def sleep_until(moment: int) -> None:
    """Sleep until a `moment` in ns of the wall clock; return at once if it is past."""
    remaining_ns = moment - time.monotonic_ns()
    if remaining_ns > 0:
        time.sleep(remaining_ns * 1e-9)


class RecordingClock:
    """Clock that passes the time of another clock and records how late (ns) each wait ended."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.lateness = array("q")

    def now(self) -> int:
        return self.clock.now()

    def wait_until(self, time: int) -> None:
        self.clock.wait_until(time)
        self.lateness.append(self.clock.now() - time)
