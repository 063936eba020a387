"""Where a command writes to: a folder that is new or empty, and gone again where nothing came of
it; a target's file that is new.
"""

import contextlib
import os
from collections.abc import Generator
from datetime import datetime
from pathlib import Path

from rcmservo.errors import Stopped, UnusableFile, require


def dated_folder(name: str) -> Path:
    """A folder under runs/ that nobody has used yet."""
    return Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}"


@contextlib.contextmanager
def new_folder(out: Path | None, name: str) -> Generator[Path]:
    """The folder to write to: the user's, which must be new or empty, or a fresh one under runs/.

    Where nothing came to be written, all folders that were made for it go again. Ctrl-C and being
    told to end are passed on with the folder in which something is.
    """
    folder = out or dated_folder(name)
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        _make_empty_folder(folder)
        yield folder
    except KeyboardInterrupt:
        raise KeyboardInterrupt(*([folder] if any(folder.iterdir()) else [])) from None
    except Stopped as stopped:
        if not any(folder.iterdir()):
            raise
        raise Stopped(f"{stopped}; what was done until then is in {folder}") from stopped
    finally:
        for path in made:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def require_new_target_file(target: Path | None, save: Path | None) -> None:
    """Refuse to keep a target that is read from a file, or in a file that is there."""
    if save is None:
        return
    right = "left out with --target: no target is shown then"
    require(target is None, "--save-target", save, right)
    if save.exists():
        why = "is there already, and nothing is overwritten: name a new file"
        raise UnusableFile(save, why)
    if not (save.parent.is_dir() and os.access(save.parent, os.W_OK)):
        raise UnusableFile(save, f"cannot be written: {save.parent} is no folder that you may use")


def _make_empty_folder(folder: Path) -> None:
    """Make the folder if it is not there, and refuse one that is in use or cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        full = any(folder.iterdir())
    except OSError as error:
        raise UnusableFile(folder, f"cannot be written to: {error.strerror}") from error
    if full:
        raise UnusableFile(folder, "is not empty, and nothing is overwritten: name a new folder")
    if not os.access(folder, os.W_OK):
        raise UnusableFile(folder, "cannot be written to")
