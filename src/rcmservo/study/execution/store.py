"""Storage of a study: a folder with one Parquet file per chunk, named by a hash of its inputs.

A stopped study resumes from these files. After a change of some settings, the chunks that do not
depend on them are reused.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

from rcmservo.config.atomic_files import atomic_path
from rcmservo.errors import UnusableFile, require_extra
from rcmservo.study.execution.chunk import RowValues
from rcmservo.study.execution.package_version import identify_package
from rcmservo.study.plan.plan import Chunk
from rcmservo.study.row import COLUMN_MEANINGS, StudyRow

with require_extra("a study", "study"):
    import pyarrow as pa
    import pyarrow.parquet as pq

PA: Any = pa
PQ: Any = pq
"""Arrow as `Any`, because it has no type annotations."""

RUNS_FILE, REPORT_FILE, SUMMARY_FILE = "runs.parquet", "report.html", "summary.json"
TUNED_FILE = "tuned.toml"
"""Study file that defines the settings found by a search as its method."""
PARTS_FOLDER = "parts"
SEARCH_FOLDER = "search"
"""Folder of the trials of a search, inside the folder of its results."""

ARROW_TYPES = {str: PA.string(), int: PA.int64(), float: PA.float64(), bool: PA.bool_()}


def _make_column(name: str, hint: Any) -> Any:
    """Return the column of a field of `StudyRow` with its type hint, such as `float | None`."""
    kind, *others = get_args(hint) or (hint,)
    metadata = {"meaning": COLUMN_MEANINGS[name]}
    return PA.field(name, ARROW_TYPES[kind], nullable=bool(others), metadata=metadata)


COLUMNS = [_make_column(name, hint) for name, hint in get_type_hints(StudyRow).items()]
SCHEMA = PA.schema(COLUMNS, COLUMN_MEANINGS)
"""Columns of runs.parquet. Their meanings are in the metadata of each column, and in that of the
file for programs that do not use Arrow."""


def make_table(rows: Iterable[RowValues]) -> Any:
    """Return rows, at least one, as a table."""
    columns = zip(*rows, strict=True)
    arrays = [PA.array(values, field.type) for values, field in zip(columns, SCHEMA, strict=True)]
    return PA.table(arrays, SCHEMA)


def compute_chunk_key(chunk: Chunk) -> str:
    """Return the key of a chunk: a hash of everything that its rows depend on."""
    text = json.dumps([identify_package(), chunk.cell.text, chunk.seeds.start, chunk.seeds.stop])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class ChunkStore:
    """Folder of a study with the rows of its chunks."""

    def __init__(self, folder: Path) -> None:
        """Raise `UnusableFile` for other content or without write access; create nothing."""
        self.folder, self.parts = folder, folder / PARTS_FOLDER
        missing = [path for path in (self.parts, folder, *folder.parents) if not path.exists()]
        try:
            is_study = self.parts.is_dir() or (folder / SEARCH_FOLDER / PARTS_FOLDER).is_dir()
            if folder.is_dir() and not is_study and any(folder.iterdir()):
                raise UnusableFile(folder, "is not empty, and holds no study: name a new folder")
            self.parts.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):  # a study that has just started may already use it
                for path in missing:
                    path.rmdir()
        except OSError as error:
            raise UnusableFile(folder, f"cannot be written to: {error.strerror}") from error
        if not missing and not os.access(self.parts, os.W_OK):
            raise UnusableFile(folder, "cannot be written to")

    def create(self) -> None:
        """Create the folder if it does not exist."""
        try:
            self.parts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UnusableFile(self.folder, f"cannot be written to: {error.strerror}") from error

    def remove_derived_files(self) -> None:
        """Remove the gathered rows and all files made from them; keep the parts."""
        for name in (RUNS_FILE, REPORT_FILE, SUMMARY_FILE, TUNED_FILE):
            path = self.folder / name
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise UnusableFile(path, f"cannot be removed: {error.strerror}") from error

    @cached_property
    def _stored(self) -> set[str]:
        """Keys of the stored chunks."""
        return {path.stem for path in self.parts.glob("*.parquet")}

    def has(self, key: str) -> bool:
        """Return True if a chunk is stored."""
        return key in self._stored

    def store(self, key: str, rows: Iterable[RowValues]) -> None:
        """Store the rows of a chunk atomically."""
        self._write_table(make_table(rows), self.parts / f"{key}.parquet")
        self._stored.add(key)

    def gather(self, keys: Iterable[str]) -> Any:
        """Write the rows of some chunks in order into one file and return them as a table."""
        tables = [self._read_part(key) for key in keys]
        table = PA.concat_tables(tables) if tables else SCHEMA.empty_table()
        self._write_table(table, self.folder / RUNS_FILE)
        return table

    def _read_part(self, key: str) -> Any:
        path = self.parts / f"{key}.parquet"
        try:
            return PQ.read_table(path, schema=SCHEMA)
        except (OSError, PA.ArrowException) as error:
            path.unlink(missing_ok=True)
            reason = "cannot be read and was removed: run the same command again to replace it"
            raise UnusableFile(path, reason) from error

    def _write_table(self, table: Any, path: Path) -> None:
        with atomic_path(path) as temporary_path:
            PQ.write_table(table, temporary_path, compression="zstd")


def read_runs(folder: Path) -> Any:
    """Read the rows of a study's folder as a table.

    Raises
    ------
    UnusableFile
        If the study is not complete, or the file is no table of runs.
    """
    try:
        return PQ.read_table(folder / RUNS_FILE, schema=SCHEMA)
    except FileNotFoundError as error:
        reason = "does not exist: the study is not complete; run its command again to resume it"
        raise UnusableFile(folder / RUNS_FILE, reason) from error
    except (OSError, PA.ArrowException) as error:
        raise UnusableFile(folder / RUNS_FILE, "is not a table of the runs of a study") from error
