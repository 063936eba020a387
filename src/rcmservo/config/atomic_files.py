"""Files that are there whole or not at all, and files that are read only if they are small."""

import stat
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from rcmservo.errors import UnusableFile


@contextmanager
def whole(path: Path) -> Generator[Path]:
    """A path to write to. It becomes the file when that went well; otherwise nothing is left."""
    part = path.with_name(path.name + ".part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise UnusableFile(path, f"cannot be written: {error.strerror}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    with whole(path) as part:
        part.write_text(text, "utf-8")


def read_small(path: Path, largest: int, what: str) -> bytes:
    """The bytes of a file of at most `largest`; a larger one, too large for `what` it should be, is
    not read.
    """
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
