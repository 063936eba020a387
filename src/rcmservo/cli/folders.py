"""Output folders, which must be new or empty, and files for targets."""

import contextlib
import os
from collections.abc import Generator
from datetime import datetime
from pathlib import Path

from rcmservo.errors import Stopped, UnusableFile, require


def make_dated_path(name: str) -> Path:
    """Return the path of an unused folder under runs/."""
    return Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}"


@contextlib.contextmanager
def open_new_folder(out: Path | None, name: str) -> Generator[Path]:
    """Yield the output folder: the user's, which must be new or empty, or a new one under runs/.

    Every folder that was created is removed if it stays empty. Otherwise Ctrl-C and a stop request
    are raised with the path of the folder.
    """
    folder = out or make_dated_path(name)
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        _make_empty_folder(folder)
        yield folder
    except KeyboardInterrupt:
        raise KeyboardInterrupt(*([folder] if any(folder.iterdir()) else [])) from None
    except Stopped as stopped:
        if not any(folder.iterdir()):
            raise
        raise Stopped(f"{stopped}; the results so far are in {folder}") from stopped
    finally:
        for path in created:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def require_new_target_file(target: Path | None, save: Path | None) -> None:
    """Refuse to save a target that was read from a file, or to overwrite a file."""
    if save is None:
        return
    expected = "left out with --target, where no target is taught"
    require(target is None, "--save-target", save, expected)
    if save.exists():
        raise UnusableFile(save, "exists and is not overwritten: name a new file")
    if not (save.parent.is_dir() and os.access(save.parent, os.W_OK)):
        raise UnusableFile(
            save, f"cannot be written: {save.parent} is not a folder that you can write to"
        )


def _make_empty_folder(folder: Path) -> None:
    """Create the folder if it is absent; refuse one that is not empty or not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_full = any(folder.iterdir())
    except OSError as error:
        raise UnusableFile(folder, f"cannot be written to: {error.strerror}") from error
    if is_full:
        raise UnusableFile(folder, "is not empty and is not overwritten: name a new folder")
    if not os.access(folder, os.W_OK):
        raise UnusableFile(folder, "cannot be written to")
