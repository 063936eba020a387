"""Faults of the computer: a process that runs late, stops for a while or is killed, and a disk that
fills up."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

from rcmservo.errors import RcmServoError
from rcmservo.record.writer import RawFile, created
from rcmservo.sim.disturbances.schedule import Schedule


class Killed(RcmServoError):
    """The simulated process was killed: from here on nothing is sent, and the arm's own watchdog
    must stop it.

    `Rig.let_pass` lets time go on without the process.
    """


class Stalls:
    """Times at which waits really end."""

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule

    def __call__(self, time: int) -> int:
        """Return the time at which the process wakes that waits until `time` ns. A killed one never
        does."""
        for event in self.schedule.begun(time, "kill"):
            self.schedule.killed = True
            raise Killed(f"the process was killed {event.disturbance.at:g} s after the start")
        for event in self.schedule.acting(time, "jitter"):
            time += round(event.random.uniform(0.0, event.number("s")) * 1e9)
        for event in self.schedule.acting(time, "stall"):
            if event.word("where") == "between":
                time = max(time, round(event.end))
        return time


class FillingDisk:
    """A record's file on a disk that takes nothing while it is ``full``."""

    def __init__(self, path: Path, full: Callable[[], bool]) -> None:
        self._file, self._full = created(path), full

    def write(self, data: memoryview, /) -> int | None:
        if self._full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def close(self) -> None:
        self._file.close()


def disk(full: Callable[[], bool]) -> Callable[[Path], RawFile]:
    """Return the function that opens a file on such a disk."""
    return lambda path: FillingDisk(path, full)
