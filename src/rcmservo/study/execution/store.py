"""What is done of a study, on disk: a folder with one Parquet file for every chunk, by the hash of
all that it depends on. A study that was stopped goes on from there, and so does one of whose
settings only some were changed.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

from rcmservo.config.atomic_files import whole
from rcmservo.errors import UnusableFile, needing
from rcmservo.study.execution.chunk import Numbers
from rcmservo.study.execution.package_version import package
from rcmservo.study.plan.plan import Chunk
from rcmservo.study.row import MEANINGS, StudyRow

with needing("a study", "study"):
    import pyarrow as pa
    import pyarrow.parquet as pq

PA: Any = pa
PQ: Any = pq
"""Arrow without types: it has none."""

RUNS, REPORT, SUMMARY = "runs.parquet", "report.html", "summary.json"
TUNED = "tuned.toml"
"""What a search found, as a study's file that has it as its method."""
PARTS = "parts"
SEARCH = "search"
"""The folder of a search's trials, in that of what is made of it."""

KINDS: dict[type, Any] = {
    str: PA.string(),
    int: PA.int64(),
    float: PA.float64(),
    bool: PA.bool_(),
}


def _field(name: str, hint: Any) -> Any:
    kinds = [kind for kind in get_args(hint) or (hint,) if kind is not type(None)]
    optional = type(None) in get_args(hint)
    about = {"meaning": MEANINGS[name]}
    return PA.field(name, KINDS[kinds[0]], nullable=optional, metadata=about)


HINTS = get_type_hints(StudyRow)
SCHEMA = PA.schema([_field(f.name, HINTS[f.name]) for f in fields(StudyRow)], MEANINGS)
"""The columns of runs.parquet; what each means is told beside it, and in the file's own metadata
too, which programs without Arrow read."""


def key_of(chunk: Chunk) -> str:
    """What a chunk's rows are known by: a hash of all that they depend on."""
    text = json.dumps([package(), chunk.cell.text, chunk.seeds.start, chunk.seeds.stop])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class Store:
    """The folder of a study."""

    def __init__(self, folder: Path) -> None:
        """Refuse a folder that holds something else, or cannot be written to; make none."""
        self.folder, self.parts = folder, folder / PARTS
        made = [path for path in (self.parts, folder, *folder.parents) if not path.exists()]
        try:
            ours = self.parts.is_dir() or (folder / SEARCH / PARTS).is_dir()
            if folder.is_dir() and not ours and any(folder.iterdir()):
                raise UnusableFile(folder, "is not empty, and holds no study: name a new folder")
            self.parts.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):  # another one that has just begun may want it
                for path in made:
                    path.rmdir()
        except OSError as error:
            raise UnusableFile(folder, f"cannot be written to: {error.strerror}") from error
        if not made and not os.access(self.parts, os.W_OK):
            raise UnusableFile(folder, "cannot be written to")

    def make(self) -> None:
        """Make the folder, where it is not there."""
        try:
            self.parts.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UnusableFile(self.folder, f"cannot be written to: {error.strerror}") from error

    def forget(self) -> None:
        """Leave no rows that are gathered, and nothing that tells of them; the parts stay."""
        for path in (self.folder / name for name in (RUNS, REPORT, SUMMARY, TUNED)):
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise UnusableFile(path, f"cannot be removed: {error.strerror}") from error

    @cached_property
    def _there(self) -> set[str]:
        return {path.stem for path in self.parts.glob("*.parquet")}

    def has(self, key: str) -> bool:
        """Whether a chunk is done."""
        return key in self._there

    def keep(self, key: str, rows: Iterable[Numbers]) -> None:
        """Keep the rows of a chunk, whole or not at all."""
        columns = list(zip(*rows, strict=True))
        table = PA.table(
            [PA.array(c, f.type) for c, f in zip(columns, SCHEMA, strict=True)], SCHEMA
        )
        self._write(table, self.parts / f"{key}.parquet")
        self._there.add(key)

    def gather(self, keys: Iterable[str]) -> Any:
        """Write all rows of some chunks into one file, in their order, and give them as a table."""
        tables = [self._part(key) for key in keys]
        table = PA.concat_tables(tables) if tables else SCHEMA.empty_table()
        self._write(table, self.folder / RUNS)
        return table

    def _part(self, key: str) -> Any:
        path = self.parts / f"{key}.parquet"
        try:
            return PQ.read_table(path, schema=SCHEMA)
        except (OSError, PA.ArrowException) as error:
            path.unlink(missing_ok=True)
            why = "cannot be read, and was removed: the same command makes it again"
            raise UnusableFile(path, why) from error

    def _write(self, table: Any, path: Path) -> None:
        with whole(path) as part:
            PQ.write_table(table, part, compression="zstd")


def runs_in(folder: Path) -> Any:
    """The rows of a study's folder, as a table."""
    try:
        return PQ.read_table(folder / RUNS, schema=SCHEMA)
    except FileNotFoundError as error:
        why = "is not there: the study is not done yet, and its command goes on where it stopped"
        raise UnusableFile(folder / RUNS, why) from error
    except (OSError, PA.ArrowException) as error:
        raise UnusableFile(folder / RUNS, "is not the runs of a study") from error
