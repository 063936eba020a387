"""Faults of the computer: a process that is late, stalls or is killed, and a full disk."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

from rcmservo.errors import RcmServoError
from rcmservo.recording.writer import RawFile, create_file
from rcmservo.sim.disturbances.schedule import Schedule


class Killed(RcmServoError):
    """Simulated process was killed: it sends nothing more, and the arm's own watchdog must stop it.

    `Rig.advance_until` lets time pass without the process.
    """


class ProcessDelays:
    """Actual ends of a process's waits."""

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule

    def __call__(self, time: int) -> int:
        """Return the time at which a process wakes that waits until `time` (ns).

        Raises
        ------
        Killed
            If the process was killed: it never wakes.
        """
        for event in self.schedule.started(time, "kill"):
            self.schedule.killed = True
            raise Killed(f"the process was killed {event.disturbance.at:g} s after the start")
        for event in self.schedule.active(time, "jitter"):
            time += round(event.random.uniform(0.0, event.number("s")) * 1e9)
        for event in self.schedule.active(time, "stall"):
            if event.word("where") == "between":
                time = max(time, round(event.end))
        return time


class FillingDisk:
    """File of a record on a disk that refuses data while it is ``full``."""

    def __init__(self, path: Path, full: Callable[[], bool]) -> None:
        self._file, self._is_full = create_file(path), full

    def write(self, data: memoryview, /) -> int | None:
        if self._is_full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def close(self) -> None:
        self._file.close()


def open_on_filling_disk(full: Callable[[], bool]) -> Callable[[Path], RawFile]:
    """Return a function that opens a file on such a disk."""
    return lambda path: FillingDisk(path, full)
