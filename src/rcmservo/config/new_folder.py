"""New folder for the results of a run or a study: nothing that exists is overwritten."""

import contextlib
import os
from collections.abc import Generator
from datetime import datetime
from pathlib import Path

from rcmservo.errors import Stopped, UnusableFile


def make_dated_path(name: str) -> Path:
    """Return the path of a folder under runs/ whose name contains the present time."""
    return Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}"


@contextlib.contextmanager
def open_new_folder(out: Path | None, name: str) -> Generator[Path]:
    """Yield the output folder `out`, which must be new or empty, or else a new one under runs/.

    Every folder that was created is removed if it stays empty. If it holds results when Ctrl-C or a
    stop request arrives, the exception is raised again with the path of the folder.

    Raises
    ------
    UnusableFile
        If the folder is not empty or cannot be written to.
    """
    folder = out or make_dated_path(name)
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        _make_empty_folder(folder)
        yield folder
    except KeyboardInterrupt:
        has_results = any(folder.iterdir())
        raise KeyboardInterrupt(*([folder] if has_results else [])) from None
    except Stopped as stopped:
        if not any(folder.iterdir()):
            raise
        raise Stopped(f"{stopped}; the results so far are in {folder}") from stopped
    finally:
        for path in created:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def _make_empty_folder(folder: Path) -> None:
    """Create the folder if it is absent; refuse one that is not empty or not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_occupied = any(folder.iterdir())
    except OSError as error:
        raise UnusableFile(folder, f"cannot be written to: {error.strerror}") from error
    if is_occupied:
        raise UnusableFile(folder, "is not empty and is not overwritten: name a new folder")
    if not os.access(folder, os.W_OK):
        raise UnusableFile(folder, "cannot be written to")
