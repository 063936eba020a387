"""Registry of the rig files that have passed `rcmservo rig check`.

A file is identified by the digest of its bytes; a changed file therefore counts as not verified.
Each file has a note in the user's state directory ($XDG_STATE_HOME, or ~/.local/state). A damaged
note is ignored. Notes prevent oversights; they are no protection against forgery.
"""

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path

from rcmservo.config import toml_json_parsing
from rcmservo.config.atomic_files import read_limited, write_atomically
from rcmservo.errors import RcmServoError, UnusableFile

NOTE_FORMAT = "rcmservo checked 1"
MAX_NOTE_BYTES = 4096
HEXADECIMAL_DIGITS = frozenset("0123456789abcdef")


def compute_digest(data: bytes) -> str:
    """Return the SHA-256 of a rig file's bytes in hexadecimal.

    Use the same bytes for the settings: the file may change between two readings.
    """
    return hashlib.sha256(data).hexdigest()


def is_rig_verified(digest: str) -> bool:
    """Return True if the rig file with this digest passed its last check."""
    try:
        note = toml_json_parsing.parse_json(
            read_limited(_find_note(digest), MAX_NOTE_BYTES, "a note").decode()
        )
    except (RcmServoError, toml_json_parsing.InvalidText, ValueError, RecursionError):
        return False
    if not toml_json_parsing.is_table(note):
        return False
    return note.get("format") == NOTE_FORMAT and note.get("sha256") == digest


def mark_rig_verified(digest: str) -> None:
    """Store that the rig file with this digest has passed the check now.

    Raises
    ------
    UnusableFile
        If the note cannot be written.
    """
    note, when = _find_note(digest), datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        note.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableFile(note.parent, f"cannot be made: {error.strerror}") from error
    content = {"format": NOTE_FORMAT, "sha256": digest, "checked": when}
    write_atomically(note, json.dumps(content, indent=1) + "\n")


def unmark_rig_verified(digest: str) -> None:
    """Remove the note of the rig file with this digest after a failed check.

    Raises
    ------
    UnusableFile
        If the note cannot be removed.
    """
    note = _find_note(digest)
    try:
        note.unlink(missing_ok=True)
    except NotADirectoryError:
        return
    except OSError as error:
        raise UnusableFile(note, f"cannot be removed: {error.strerror}") from error


def _find_note(digest: str) -> Path:
    """Return the path of the note for a digest."""
    assert len(digest) == 64 and set(digest) <= HEXADECIMAL_DIGITS
    configured = Path(os.environ.get("XDG_STATE_HOME", ""))
    state = configured if configured.is_absolute() else Path(os.path.expanduser("~/.local/state"))
    if not state.is_absolute():
        raise UnusableFile(
            state, "is no absolute path because the home directory is unknown: set XDG_STATE_HOME"
        )
    return state / "rcmservo" / "checked" / f"{digest}.json"
