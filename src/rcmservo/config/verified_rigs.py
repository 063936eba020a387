"""Registry of the rig files that have passed `rcmservo rig check`.

A rig file that has passed may use the full speed of its arm. A file is identified by the digest of
its bytes; a changed file therefore counts as not verified. Each verified file has a note, a small
JSON file in the user's state directory ($XDG_STATE_HOME, or ~/.local/state). A damaged note is
ignored. Notes prevent oversights; they are no protection against forgery.
"""

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path

from rcmservo.config.atomic_files import read_limited, write_atomically
from rcmservo.config.toml_json_parsing import is_table, parse_json
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
        note = parse_json(read_limited(_find_note(digest), MAX_NOTE_BYTES, "a note").decode())
    except (RcmServoError, ValueError, RecursionError):
        return False
    described = (note.get("format"), note.get("sha256")) if is_table(note) else None
    return described == (NOTE_FORMAT, digest)


def mark_rig_verified(digest: str) -> None:
    """Write a note that the rig file with this digest has passed the check now.

    Raises
    ------
    UnusableFile
        If the note cannot be written.
    """
    note, now = _find_note(digest), datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        note.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableFile(note.parent, f"cannot be made: {error.strerror}") from error
    content = {"format": NOTE_FORMAT, "sha256": digest, "checked": now}
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
    folder = configured if configured.is_absolute() else Path(os.path.expanduser("~/.local/state"))
    if not folder.is_absolute():
        reason = "is no absolute path because the home directory is unknown: set XDG_STATE_HOME"
        raise UnusableFile(folder, reason)
    return folder / "rcmservo" / "checked" / f"{digest}.json"
