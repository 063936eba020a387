"""Atomic writing of files, and reading of files up to a maximum size.

A file that is written atomically is either complete or unchanged, even if the program crashes.
"""

import stat
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from rcmservo.errors import UnusableFile


@contextmanager
def atomic_path(path: Path) -> Generator[Path]:
    """Yield the path of a temporary file, which replaces the file `path` on success.

    After an error the temporary file is removed, and an earlier file stays unchanged.

    Raises
    ------
    UnusableFile
        If the file cannot be written.
    """
    partial_path = path.with_name(path.name + ".part")
    try:
        yield partial_path
        partial_path.replace(path)
    except OSError as error:
        raise UnusableFile(path, f"cannot be written: {error.strerror}") from error
    finally:
        with suppress(OSError):
            partial_path.unlink(missing_ok=True)


def write_atomically(path: Path, text: str) -> None:
    """Write a text atomically: an error or a crash leaves no incomplete file."""
    with atomic_path(path) as partial_path:
        partial_path.write_text(text, "utf-8")


def read_limited(path: Path, max_bytes: int, description: str) -> bytes:
    """Return the bytes of a regular file that has at most `max_bytes`.

    Parameters
    ----------
    path : Path
        File to read.
    max_bytes : int
        Maximum size, bytes.
    description : str
        Noun phrase for such a file, which the error message ends with.

    Raises
    ------
    UnusableFile
        If the file cannot be read or is larger than ``max_bytes``.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise UnusableFile(path, "is not a file")
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise UnusableFile(path, f"cannot be read: {error.strerror}") from error
    if len(data) > max_bytes:
        raise UnusableFile(path, f"is larger than {max_bytes} bytes, too large for {description}")
    return data
