"""Files that are there whole or not at all, and files that are read only if they are small."""

import stat
from pathlib import Path

from rcmservo.errors import UnusableFile


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text)
        part.replace(path)
    except OSError as error:
        raise UnusableFile(path, f"cannot be written: {error.strerror}") from error


def read_small(path: Path, largest: int, what: str) -> bytes:
    """The bytes of a file of at most `largest`; a larger one, too large for `what` it should be, is
    not read."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnusableFile(path, "is not a file")
        with path.open("rb") as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error.strerror}") from error
    if len(data) > largest:
        raise UnusableFile(path, f"is larger than {largest} bytes, too large for {what}")
    return data
