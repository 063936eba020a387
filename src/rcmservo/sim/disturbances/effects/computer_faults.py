"""Faults of the computer: a process that is late, stalls or is killed, and a full disk."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

from rcmservo.errors import RcmServoError
from rcmservo.recording.writer import RawFile, create_file
from rcmservo.sim.disturbances.schedule import Schedule


class Killed(RcmServoError):
    """Simulated kill of the process that runs the servo.

    The process sends nothing more, and the arm's own watchdog must stop the arm.
    `Rig.advance_until` lets time pass without the process.
    """


class ProcessDelays:
    """Delays of the process that runs the servo: the actual ends of its waits."""

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule

    def __call__(self, time: int) -> int:
        """Return the time (ns) at which the process wakes from a wait until `time` (ns).

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


class FileOnFillingDisk:
    """File on a disk that refuses data while it is full.

    Parameters
    ----------
    path : pathlib.Path
        Path of the file, which must not exist.
    is_full : callable
        Returns True while the disk is full.
    """

    def __init__(self, path: Path, is_full: Callable[[], bool]) -> None:
        self._file, self._is_full = create_file(path), is_full

    def write(self, data: memoryview, /) -> int | None:
        """Write data; raise the system's error for a full disk while the disk is full."""
        if self._is_full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._file.write(data)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def open_on_filling_disk(is_full: Callable[[], bool]) -> Callable[[Path], RawFile]:
    """Return a function that opens a file at a path on a disk that `is_full` describes."""
    return lambda path: FileOnFillingDisk(path, is_full)
