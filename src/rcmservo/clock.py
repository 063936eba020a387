"""Ticks on an absolute schedule: the k-th tick is due at start + k/rate, however long the one before took."""

from collections.abc import Iterator

from rcmservo.errors import require
from rcmservo.plant import Clock


def ticks(clock: Clock, rate: float = 100.0, duration: float = float("inf")) -> Iterator[int]:
    """Wait for each tick and yield its time in ns since the first, at `rate` Hz for `duration` s.

    A tick that is due when the one before is not done yet is skipped: there is never a burst to catch up.
    """
    require(0.0 < rate < float("inf"), "rate", rate, "a positive frequency in Hz")
    require(duration > 0.0, "duration", duration, "a positive time in s")
    start = clock.now()
    k = 0
    while k < duration * rate:
        due = start + round(k * 1e9 / rate)
        clock.wait_until(due)
        yield due - start
        k = max(k + 1, int((clock.now() - start) * rate / 1e9) + 1)
