"""Retries of tests in wall time after the machine stalled, or had no time left.

A stall of the machine stops an arm, as it should. A claim about an undisturbed run in wall time
therefore needs an attempt without a stall. It also needs time to spare: on a machine half as fast
as those for which they were written, emulator, camera and servo together are late without a stall.
"""

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

MAX_ATTEMPTS = 5
MIN_STALL_NS = 20_000_000
"""Shortest interruption that counts as a stall: two ticks."""
MAX_BUSY_FRACTION = 0.6
"""Largest fraction of the processors' time that was used in an attempt with time to spare."""
MONITOR_PRIORITY = 90
"""Real-time priority of the monitor's threads, from 1 to 99."""

Run = TypeVar("Run")


class StallMonitor:
    """Monitor of the longest interruption of any processor, and of the time that they were busy.

    One thread on each processor waits 1 ms at a time and measures the delay, with real-time
    priority where the system allows it: a virtual machine may stall on one of its processors only.
    """

    def __init__(self) -> None:
        self.longest, self.busy_fraction = 0, 0.0
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=self._watch_processor, args=(processor,))
            for processor in os.sched_getaffinity(0)
        ]

    def __enter__(self) -> "StallMonitor":
        self._before = read_processor_time()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()
        busy, total = read_processor_time() - self._before
        self.busy_fraction = float(busy / max(total, 1))

    def _watch_processor(self, processor: int) -> None:
        os.sched_setaffinity(0, {processor})
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(MONITOR_PRIORITY))
        self._watch()

    def _watch(self) -> None:
        before = time.monotonic_ns()
        while not self._ended.wait(0.001):
            now = time.monotonic_ns()
            self.longest = max(self.longest, now - before)
            before = now


def read_processor_time() -> NDArray[np.int64]:
    """Return the time since the start that the processors were busy, and all of it, in ticks."""
    user, nice, system, idle, waiting, *others = map(
        int, Path("/proc/stat").read_text("ascii").split("\n", 1)[0].split()[1:9]
    )
    busy = user + nice + system + sum(others)
    return np.array([busy, busy + idle + waiting])


def retry_after_stalls(attempt: Callable[[], Run], has_succeeded: Callable[[Run], bool]) -> Run:
    """Return the result of an attempt, repeated while it fails and the machine is disturbed.

    The machine stalls, or its processors have no time to spare. Skip the test if it does so in
    every attempt.
    """
    for k in range(MAX_ATTEMPTS):
        with StallMonitor() as monitor:
            run = attempt()
        is_disturbed = monitor.longest >= MIN_STALL_NS or monitor.busy_fraction >= MAX_BUSY_FRACTION
        if has_succeeded(run) or not is_disturbed:
            return run
        print(f"attempt {k + 1}, in which this machine stalled for", end=" ")
        print(f"{monitor.longest * 1e-6:.0f} ms and was busy", end=" ")
        print(f"for {100 * monitor.busy_fraction:.0f} % of the time: {run!s:.500}")
    pytest.skip(
        f"this machine stalled or was busy in each of {MAX_ATTEMPTS} attempts; "
        f"the last: {run!s:.500}"
    )
