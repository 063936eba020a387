"""List of the past runs.

Each run has a name that is a hash of its path. A browser can request a run only by this name, and
so no other file.
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

    def list_runs(self) -> list[PastRun]:
        """Return the runs, the newest first."""
        with self._lock:
            found = sorted(self._records(), reverse=True)[:MAX_RUNS]
            self._paths = {self._name(path): path for _, path in found}
            self._headers = {p: self._headers[p] for _, p in found if p in self._headers}
            return [self._describe(path) for _, path in found]

    def find_record(self, name: str) -> Path | None:
        """Return the record of a listed run if it still exists."""
        path = self._paths.get(name)
        return path if path is not None and path.is_file() else None

    def _records(self) -> Iterator[tuple[int, Path]]:
        """Yield the records with the times of their last changes, except behind symbolic links."""
        for pattern in RECORD_PATTERNS:
            for path in self._root.glob(pattern):
                steps = (path, *path.relative_to(self._root).parents)
                if not any((self._root / step).is_symlink() for step in steps if step != Path()):
                    yield path.stat().st_mtime_ns, path

    def _name(self, path: Path) -> str:
        return blake2s(str(path.relative_to(self._root)).encode(), digest_size=8).hexdigest()

    def _describe(self, path: Path) -> PastRun:
        changed = path.stat().st_mtime
        header = self._cached_header(path)
        common = self._name(path), str(path.parent.relative_to(self._root))
        when = f"{datetime.fromtimestamp(changed):%Y-%m-%d %H:%M:%S}"
        if isinstance(header, str):
            return PastRun(*common, when, header, None, "cannot be read", False)
        is_recording = not header.is_closed and time.time() - changed < RECORDING_TIMEOUT_S
        description = describe_run(header.settings, header.servo)
        ending = describe_ending(header, is_recording)
        return PastRun(*common, when, description, header.seconds, ending, is_recording)

    def _cached_header(self, path: Path) -> RecordHeader | str:
        """Return a record's header, or why it cannot be read; read it again after a change."""
        status = path.stat()
        key = status.st_mtime_ns, status.st_size
        cached = self._headers.get(path)
        if cached is None or cached[0] != key:
            cached = self._headers[path] = key, _read_or_explain(path)
        return cached[1]


def _read_or_explain(path: Path) -> RecordHeader | str:
    try:
        return read_header(path)
    except (RcmServoError, ValueError, OSError) as error:
        return str(error).replace(f"{path.parent}/", "")


def describe_ending(header: RecordHeader, is_recording: bool) -> str:
    """Return the end of a run in words."""
    last = ", ".join(filter(None, (header.phase, header.cause))) or "no tick"
    if is_recording:
        return f"is being recorded: {last}"
    return last if header.is_closed else f"record without its end; last: {last}"
