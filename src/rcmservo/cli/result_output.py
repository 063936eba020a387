"""Output of a run's result: figures, the file metrics.json and the printed table."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from rcmservo.cli.terminal import build_two_column_table
from rcmservo.config.atomic_files import write_atomically
from rcmservo.errors import UnusableFile
from rcmservo.figures import charts, plots
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.reader import Record
from rcmservo.recording.summary_text import format_title, list_result_rows

METRICS_FILE = "metrics.json"
"""File of the result in the folder of a run."""

EXIT_NOT_SETTLED = 1
"""Exit code of a run that did not settle."""


def save_result(result: RunResult, record: Record | None, folder: Path) -> RunResult:
    """Write the figures and metrics.json.

    Returns
    -------
    RunResult
        Result with the folder. A file that could not be written is named in it and raises no
        error, so that the result is not lost.
    """
    result = replace(result, folder=str(folder))
    if record is not None:
        result = _note_failed_write(result, lambda: draw_figures(record, folder))
    text = json.dumps(asdict(result), indent=2) + "\n"
    return _note_failed_write(result, lambda: write_atomically(folder / METRICS_FILE, text))


def _note_failed_write(result: RunResult, write: Callable[[], None]) -> RunResult:
    """Call a function that writes; if it fails, return the result with the reason."""
    try:
        write()
    except (UnusableFile, OSError) as error:
        reasons = "; ".join(filter(None, (result.not_written, str(error))))
        return replace(result, not_written=reasons)
    return result


def read_record_if_any(folder: Path) -> Record | None:
    """Return the record of a run, or None if it holds nothing."""
    with suppress(UnusableFile):
        return reader.read_record(folder)
    return None


def draw_figures(record: Record, folder: Path) -> None:
    """Draw the errors and the estimate over time, unless no tick has an error."""
    if np.isfinite(record.ticks["delta"]).any():
        charts.save_figure(plots.plot_errors(record), folder / "errors.png")
        charts.save_figure(plots.plot_estimate(record), folder / "estimate.png")


def print_result(console: Console, result: RunResult, as_json: bool) -> int:
    """Print the result as a table, or as JSON on stdout; return the exit code of the command."""
    if as_json:
        print(json.dumps(asdict(result)))
    else:
        console.print(build_two_column_table(format_title(result), list_result_rows(result)))
        console.print(f"files in {result.folder}", soft_wrap=True)
    return 0 if result.settled else EXIT_NOT_SETTLED
