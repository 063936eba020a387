"""A disk that fills up: what a record is written to while a disturbance says so."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

from rcmservo.record.writer import RawFile, created


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
