"""Which lab files have passed `rcmservo rig check`: by their bytes, so that a file that was changed
since counts as a new one.

A note of each is kept under the user's state folder ($XDG_STATE_HOME, or ~/.local/state). One that
is damaged counts as none. Notes guard against haste, not against whoever writes them by hand.
"""

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path

from rcmservo.config import texts
from rcmservo.config.atomic_files import read_small, write_whole
from rcmservo.errors import RcmServoError, UnusableFile

FORMAT = "rcmservo checked 1"
MAX_SIZE = 4096
DIGITS = frozenset("0123456789abcdef")


def digest_of(data: bytes) -> str:
    """What a lab file's bytes are known by: SHA-256 in hexadecimal. Take it of the same bytes that
    the settings are read from.
    """
    return hashlib.sha256(data).hexdigest()


def is_checked(digest: str) -> bool:
    """Whether the lab file with this digest has passed, and has not failed since."""
    try:
        told = texts.from_json(read_small(_note(digest), MAX_SIZE, "a note").decode())
    except (RcmServoError, texts.Refused, ValueError, RecursionError):
        return False
    if not texts.is_table(told):
        return False
    return told.get("format") == FORMAT and told.get("sha256") == digest


def note_checked(digest: str) -> None:
    """Note that the lab file with this digest has passed now."""
    note, when = _note(digest), datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        note.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableFile(note.parent, f"cannot be made: {error.strerror}") from error
    content = {"format": FORMAT, "sha256": digest, "checked": when}
    write_whole(note, json.dumps(content, indent=1) + "\n")


def forget_checked(digest: str) -> None:
    """Forget that it has passed, if it has: it failed now."""
    note = _note(digest)
    try:
        note.unlink(missing_ok=True)
    except NotADirectoryError:
        return
    except OSError as error:
        raise UnusableFile(note, f"cannot be removed: {error.strerror}") from error


def _note(digest: str) -> Path:
    """Where the note of this digest is."""
    assert len(digest) == 64 and set(digest) <= DIGITS
    told = Path(os.environ.get("XDG_STATE_HOME", ""))
    state = told if told.is_absolute() else Path(os.path.expanduser("~/.local/state"))
    if not state.is_absolute():
        raise UnusableFile(state, "is nowhere, as you have no home folder: set XDG_STATE_HOME")
    return state / "rcmservo" / "checked" / f"{digest}.json"
