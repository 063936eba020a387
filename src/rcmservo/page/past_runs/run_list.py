"""List of the past runs below a folder.

The name of a run is a hash of its path. Because a browser can request a run only by this name, it
can read no other file.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from hashlib import blake2s
from pathlib import Path
from threading import Lock

from rcmservo.errors import RcmServoError
from rcmservo.recording.reader import RECORD
from rcmservo.recording.record_header import RecordHeader, read_header
from rcmservo.recording.summary_text import describe_run

MAX_RUNS = 1000
"""Number of runs in the list, the newest."""

RECORDING_TIMEOUT_S = 5.0
"""Time (s) without a change after which an open record counts as cut off."""

RECORD_PATTERNS = f"*/{RECORD}", f"*/*/{RECORD}"
"""Locations of records: in the folder of a run and in that of a session."""


@dataclass(frozen=True)
class PastRun:
    """Run in the list.

    Parameters
    ----------
    name : str
        Name by which a browser requests it.
    folder : str
        Folder, relative to the folder of all runs.
    changed : str
        Date and time of the last change.
    description : str
        Arm and estimator; or the reason why the record cannot be read.
    seconds : float or None
        Length in s; None if the record cannot be read.
    ending : str
        End of the run in words.
    is_recording : bool
        The run is being recorded now.
    """

    name: str
    folder: str
    changed: str
    description: str
    seconds: float | None
    ending: str
    is_recording: bool


class RunList:
    """List of the runs below a folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = Lock()
        self._paths: dict[str, Path] = {}
        self._headers: dict[Path, tuple[tuple[int, int], RecordHeader | str]] = {}
        """Time of the last change and size of each record, with its header or why it has none."""

    def list_runs(self) -> list[PastRun]:
        """Return the runs, the newest first."""
        with self._lock:
            paths = [path for _, path in sorted(self._iterate_records(), reverse=True)[:MAX_RUNS]]
            self._paths = {self._hash_path(path): path for path in paths}
            self._headers = {p: self._headers[p] for p in paths if p in self._headers}
            return [self._describe(path) for path in paths]

    def find_record(self, name: str) -> Path | None:
        """Return the record of a listed run if it still exists."""
        path = self._paths.get(name)
        return path if path is not None and path.is_file() else None

    def _iterate_records(self) -> Iterator[tuple[int, Path]]:
        """Yield the records with the times of their last changes, except behind symbolic links."""
        for pattern in RECORD_PATTERNS:
            for path in self._root.glob(pattern):
                folders = [self._root / f for f in path.relative_to(self._root).parents[:-1]]
                if not any(part.is_symlink() for part in (path, *folders)):
                    yield path.stat().st_mtime_ns, path

    def _hash_path(self, path: Path) -> str:
        return blake2s(str(path.relative_to(self._root)).encode(), digest_size=8).hexdigest()

    def _describe(self, path: Path) -> PastRun:
        changed_s = path.stat().st_mtime
        header = self._read_cached_header(path)
        name, folder = self._hash_path(path), str(path.parent.relative_to(self._root))
        changed = f"{datetime.fromtimestamp(changed_s):%Y-%m-%d %H:%M:%S}"
        if isinstance(header, str):
            return PastRun(name, folder, changed, header, None, "cannot be read", False)
        is_recording = not header.is_closed and time.time() - changed_s < RECORDING_TIMEOUT_S
        description = describe_run(header.settings, header.servo)
        ending = describe_ending(header, is_recording)
        return PastRun(name, folder, changed, description, header.seconds, ending, is_recording)

    def _read_cached_header(self, path: Path) -> RecordHeader | str:
        """Return a record's header, or why it cannot be read; read it again after a change."""
        status = path.stat()
        version = status.st_mtime_ns, status.st_size
        cached_version, header = self._headers.get(path, (None, ""))
        if cached_version != version:
            self._headers[path] = version, (header := _read_or_explain(path))
        return header


def _read_or_explain(path: Path) -> RecordHeader | str:
    """Return a record's header, or why it cannot be read."""
    try:
        return read_header(path)
    except (RcmServoError, ValueError, OSError) as error:
        return str(error).replace(f"{path.parent}/", "")


def describe_ending(header: RecordHeader, is_recording: bool) -> str:
    """Return the end of a run in words."""
    last_tick = ", ".join(filter(None, (header.phase, header.cause))) or "no tick"
    if is_recording:
        return f"is being recorded: {last_tick}"
    return last_tick if header.is_closed else f"record without its end; last: {last_tick}"
