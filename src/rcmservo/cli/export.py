"""`rcmservo export`: a record as tables for other programs, and its frames as a recording.

ticks.csv     one row per tick, units in the header; unknown values are empty
record.npz    the same numbers as arrays, bit for bit, with the stages and settings
recording/    the frames, if the record holds any, in the format that `replay` reads
"""

import csv
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import tyro

from rcmservo.cli.folders import open_new_folder
from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import atomic_path
from rcmservo.config.servo_json import rebuild_part
from rcmservo.errors import BadInput, UnusableFile
from rcmservo.interfaces import Floats
from rcmservo.recording import reader
from rcmservo.recording.foreign.frame_folder import RecordingWriter
from rcmservo.recording.reader import Record
from rcmservo.recording.tick_schema import (
    FLAG_COLUMNS,
    INTEGER_COLUMNS,
    REAL_COLUMNS,
    TRUTH_COLUMNS,
)

COLUMN_UNITS = {
    column.name: column.parts for column in (*INTEGER_COLUMNS, *REAL_COLUMNS, *FLAG_COLUMNS)
}
"""Titles of the parts of each tick column, with their units."""

TICKS_PER_BLOCK = 1000
"""Ticks that are formatted at a time, so that a long run does not fill the memory."""


@dataclass(frozen=True)
class ExportOptions:
    """Write a recorded run as CSV and NumPy arrays.

    If the record holds frames, they are written as a recording that `replay` reads.

    Parameters
    ----------
    record : Path
        Folder of a run, or an .mcap file.
    out : Path or None
        New or empty output folder; by default a new one under runs/.
    """

    record: Annotated[Path, tyro.conf.Positional]
    out: Path | None = None


def export(options: ExportOptions) -> int:
    """Export a record and return the exit code 0."""
    out = open_console()
    with open_new_folder(options.out, "export") as folder:
        written = export_record(options.record, folder)
    counts = f"{written.ticks} ticks" + (f" and {written.frames} frames" if written.frames else "")
    left = (
        f"; left out, because no tick records their joints: {written.frames_without_joints} frames"
        if written.frames_without_joints
        else ""
    )
    missing = f"; {written.missing}" if written.missing else ""
    out.print(f"{counts} written to {folder}{left}{missing}", soft_wrap=True)
    return 0


@dataclass(frozen=True)
class ExportSummary:
    """Counts of an export.

    Parameters
    ----------
    ticks : int
        Rows of ticks.csv.
    frames : int
        Images in recording/.
    frames_without_joints : int
        Frames that are left out because no tick records the joints at their exposure.
    missing : str
        Unreadable parts of the record, in words; empty if there are none.
    """

    ticks: int
    frames: int
    frames_without_joints: int
    missing: str


def export_record(path: Path, folder: Path) -> ExportSummary:
    """Write the record of a run to an empty folder."""
    record = reader.read_record(path)
    _write_csv(record, folder / "ticks.csv")
    with atomic_path(folder / "record.npz") as part, part.open("wb") as file:
        np.savez_compressed(file, **convert_to_arrays(record))
    frames, left_out = _write_frames(record, folder / "recording")
    return ExportSummary(len(record.time), frames, left_out, record.missing)


def convert_to_arrays(rows: Record) -> dict[str, Any]:
    """Return a record as arrays by name.

    Times (s), ticks, truth and words have N rows, stages S rows. No array holds Python objects,
    which NumPy could only store as a pickle.
    """
    return {
        "time": rows.time,
        **rows.ticks,
        **{f"truth_{name}": column for name, column in rows.truth.items()},
        **{name: np.array(words, dtype=np.str_) for name, words in rows.words.items()},
        "stage_first": np.array([stage.first for stage in rows.stages], dtype=np.int64),
        "stage_target_points": np.array(
            [stage.target.points for stage in rows.stages], dtype=np.float64
        ).reshape(-1, 2, 2),
        "stage_target_q": np.array(
            [stage.target.q for stage in rows.stages], dtype=np.float64
        ).reshape(-1, 3),
        "stage_servo": np.array([json.dumps(stage.servo) for stage in rows.stages], dtype=np.str_),
        "about": np.array(json.dumps(rows.about), dtype=np.str_),
        "missing": np.array(rows.missing, dtype=np.str_),
    }


def _write_csv(rows: Record, path: Path) -> None:
    titles, columns = _collect_csv_columns(rows)
    with atomic_path(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(titles)
        for i in range(0, len(rows.time), TICKS_PER_BLOCK):
            block = (_format_column(column[i : i + TICKS_PER_BLOCK]) for column in columns)
            writer.writerows(zip(*block, strict=True))


def _collect_csv_columns(rows: Record) -> tuple[list[str], list[Any]]:
    """Return the titles of the table and its columns (N,)."""
    titles: list[str] = ["time [s]"]
    columns: list[Any] = [rows.time]
    tables = [("", rows.ticks, COLUMN_UNITS), ("truth_", rows.truth, TRUTH_COLUMNS)]
    for start, table, units in tables if len(rows.truth["p1"]) else tables[:1]:
        for name, column in table.items():
            for i, unit in enumerate(units.get(name) or _number_titles(column)):
                titles.append(f"{start}{name}{' ' if unit.startswith('[') else '_'}{unit}")
                columns.append(column[:, i])
    return [*titles, *rows.words], [*columns, *rows.words.values()]


def _number_titles(column: Any) -> tuple[str, ...]:
    """Return titles for values whose meaning only a user-defined estimator knows."""
    return tuple(f"{i + 1} [own]" for i in range(column.shape[1]))


def _format_column(column: Any) -> Iterable[Any]:
    """Return the words or numbers of a column without loss; NaN becomes an empty string."""
    if isinstance(column, list):
        return cast(list[str], column)
    if column.dtype.kind == "f":
        return ["" if math.isnan(value) else repr(value) for value in column.tolist()]
    return column.astype(np.int64).tolist()


def _write_frames(rows: Record, folder: Path) -> tuple[int, int]:
    """Write the frames with their joints; return the numbers of written and omitted frames."""
    joints = _map_joints_by_exposure(rows)
    writer, count, left_out = None, 0, 0
    for exposure, jpeg in reader.iterate_jpegs(rows.path):
        q = joints.get(exposure)
        if q is None:
            left_out += 1
            continue
        if writer is None:
            writer = RecordingWriter(folder, _read_mechanism(rows))
        writer.write(jpeg, q, exposure)
        count += 1
    return count, left_out


def _map_joints_by_exposure(rows: Record) -> dict[int, Floats]:
    """Return the joints (3,) at each exposure that a tick used."""
    exposures, joints = rows.ticks["exposure"][:, 0].tolist(), rows.ticks["q_exposure"]
    return {
        exposure: q for exposure, q in zip(exposures, joints, strict=True) if np.isfinite(q).all()
    }


def _read_mechanism(rows: Record) -> Any:
    try:
        return rebuild_part(rows.stages[0].servo, "mechanism")
    except (IndexError, BadInput) as error:
        raise UnusableFile(
            rows.path, "does not record the mechanism, which its frames need"
        ) from error
