"""`rcmservo export`: the record of a run as tables for other programs, and its frames.

ticks.csv     one row per tick, units in the header; unknown values are empty
record.npz    the same numbers as NumPy arrays, bit for bit, with the stages and settings
recording/    the frames, if the record holds any, in the format that `rcmservo replay` reads

A record is stored in ticks, the periods of the servo loop. Its stages are the parts of the run with
one target and one servo.
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

from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import atomic_path
from rcmservo.config.new_folder import open_new_folder
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

COLUMN_UNITS = {c.name: c.parts for c in (*INTEGER_COLUMNS, *REAL_COLUMNS, *FLAG_COLUMNS)}
"""Titles of the entries of each tick column, with their units."""

TICKS_PER_BLOCK = 1000
"""Number of ticks that are formatted at a time, so that a long run does not fill the memory."""


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
    """Export a record, print a summary and return the exit code 0."""
    with open_new_folder(options.out, "export") as folder:
        summary = export_record(options.record, folder)
    open_console().print(summary, soft_wrap=True)
    return 0


def export_record(path: Path, folder: Path) -> str:
    """Write the record of a run to an empty folder and return a summary of one sentence."""
    record = reader.read_record(path)
    _write_csv(record, folder / "ticks.csv")
    with atomic_path(folder / "record.npz") as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **convert_to_arrays(record))
    written_count, omitted_count = _write_frames(record, folder / "recording")
    frames = f" and {written_count} frames" if written_count else ""
    summary = f"{len(record.time)} ticks{frames} written to {folder}"
    if omitted_count:
        reason = "left out, because no tick records their joints"
        summary += f"; {reason}: {omitted_count} frames"
    return "; ".join(filter(None, (summary, record.missing)))


def convert_to_arrays(record: Record) -> dict[str, Any]:
    """Return a record as arrays by name.

    Times (s), ticks, truth and words have N rows for N ticks, stages S rows. No array holds Python
    objects, which NumPy could only store as a pickle.
    """
    stages = record.stages
    points = [stage.target.points for stage in stages]
    joints = [stage.target.q for stage in stages]
    return {
        "time": record.time,
        **record.ticks,
        **{f"truth_{name}": column for name, column in record.truth.items()},
        **{name: np.array(words, dtype=np.str_) for name, words in record.words.items()},
        "stage_first": np.array([stage.first for stage in stages], dtype=np.int64),
        "stage_target_points": np.array(points, dtype=np.float64).reshape(-1, 2, 2),
        "stage_target_q": np.array(joints, dtype=np.float64).reshape(-1, 3),
        "stage_servo": np.array([json.dumps(stage.servo) for stage in stages], dtype=np.str_),
        "about": np.array(json.dumps(record.about), dtype=np.str_),
        "missing": np.array(record.missing, dtype=np.str_),
    }


def _write_csv(record: Record, path: Path) -> None:
    """Write the ticks as a table, block by block."""
    titles, columns = _collect_csv_columns(record)
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(titles)
        for i in range(0, len(record.time), TICKS_PER_BLOCK):
            block = (_format_column(column[i : i + TICKS_PER_BLOCK]) for column in columns)
            writer.writerows(zip(*block, strict=True))


def _collect_csv_columns(record: Record) -> tuple[list[str], list[Any]]:
    """Return the titles of the table and its columns, each with N values for N ticks."""
    titles: list[str] = ["time [s]"]
    columns: list[Any] = [record.time]
    tables = [("", record.ticks, COLUMN_UNITS), ("truth_", record.truth, TRUTH_COLUMNS)]
    has_truth = len(record.truth["p1"]) > 0
    for prefix, table, units in tables if has_truth else tables[:1]:
        for name, column in table.items():
            for i, unit in enumerate(units.get(name) or _number_titles(column)):
                titles.append(f"{prefix}{name}{' ' if unit.startswith('[') else '_'}{unit}")
                columns.append(column[:, i])
    return [*titles, *record.words], [*columns, *record.words.values()]


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


def _write_frames(record: Record, folder: Path) -> tuple[int, int]:
    """Write the frames with their joints; return the numbers of written and omitted frames."""
    joints_by_exposure = _map_joints_by_exposure(record)
    writer, written_count, omitted_count = None, 0, 0
    for exposure, jpeg in reader.iterate_jpegs(record.path):
        q = joints_by_exposure.get(exposure)
        if q is None:
            omitted_count += 1
            continue
        writer = writer or RecordingWriter(folder, _read_mechanism(record))
        writer.write(jpeg, q, exposure)
        written_count += 1
    return written_count, omitted_count


def _map_joints_by_exposure(record: Record) -> dict[int, Floats]:
    """Return the joints (3,) at each time of exposure (ns) that a tick used."""
    exposures, joints = record.ticks["exposure"][:, 0].tolist(), record.ticks["q_exposure"]
    pairs = zip(exposures, joints, strict=True)
    return {exposure: q for exposure, q in pairs if np.isfinite(q).all()}


def _read_mechanism(record: Record) -> Any:
    """Return the mechanism of the recorded servo; raise `UnusableFile` if it is not recorded."""
    try:
        return rebuild_part(record.stages[0].servo, "mechanism")
    except (IndexError, BadInput) as error:
        reason = "does not record the mechanism, which its frames need"
        raise UnusableFile(record.path, reason) from error
