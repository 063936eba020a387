"""File that a target is saved in: it must be new, and there must be a target to save."""

import os
from pathlib import Path

from rcmservo.errors import UnusableFile, require


def require_new_target_file(target: Path | None, save_target: Path | None) -> None:
    """Refuse --save-target for a target that --target reads, or for a file that exists.

    Raises
    ------
    BadInput
        If both options are given.
    UnusableFile
        If the file `save_target` exists or cannot be written.
    """
    if save_target is None:
        return
    expected = "left out with --target, where no target is taught"
    require(target is None, "--save-target", save_target, expected)
    if save_target.exists():
        raise UnusableFile(save_target, "exists and is not overwritten: name a new file")
    folder = save_target.parent
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        reason = f"cannot be written: {folder} is not a folder that you can write to"
        raise UnusableFile(save_target, reason)
