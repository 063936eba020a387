"""Retries of tests in wall time after the machine stalled.

A stall of the machine stops an arm, as it should. A claim about an undisturbed run in wall time
therefore needs an attempt without a stall.
"""

import contextlib
import os
import threading
import time
from collections.abc import Callable
from typing import TypeVar

import pytest

MAX_ATTEMPTS = 5
MIN_STALL_NS = 20_000_000
"""Shortest interruption that counts as a stall: two ticks."""
MONITOR_PRIORITY = 90
"""Real-time priority of the monitor's threads, from 1 to 99."""

Run = TypeVar("Run")


class StallMonitor:
    """Monitor of the longest interruption of any processor.

    One thread on each processor waits 1 ms at a time and measures the delay, with real-time
    priority where the system allows it: a virtual machine may stall on one of its processors only.
    """

    def __init__(self) -> None:
        self.longest = 0
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(target=self._watch_processor, args=(processor,))
            for processor in os.sched_getaffinity(0)
        ]

    def __enter__(self) -> "StallMonitor":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()

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


def retry_after_stalls(attempt: Callable[[], Run], has_succeeded: Callable[[Run], bool]) -> Run:
    """Return the result of an attempt, repeated while it fails and the machine stalls.

    Skip the test if the machine stalls in every attempt.
    """
    for k in range(MAX_ATTEMPTS):
        with StallMonitor() as monitor:
            run = attempt()
        if has_succeeded(run) or monitor.longest < MIN_STALL_NS:
            return run
        print(f"attempt {k + 1}, in which this machine stalled for", end=" ")
        print(f"{monitor.longest * 1e-6:.0f} ms: {run!s:.500}")
    pytest.skip(f"this machine stalled in each of {MAX_ATTEMPTS} attempts; the last: {run!s:.500}")
