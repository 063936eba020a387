"""Result of a run with its record: in words, as a table, as figures and as files."""

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rcmservo.config.atomic_files import write_atomically
from rcmservo.errors import UnusableFile
from rcmservo.figures import charts, plots
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.reader import Record
from rcmservo.recording.ros2_bag import METADATA
from rcmservo.recording.summary_text import format_title, list_result_rows

METRICS_FILE = "metrics.json"
"""File of the result in the folder of a run."""

AnyResult = TypeVar("AnyResult", bound=RunResult)


@dataclass(frozen=True)
class RecordedResult(RunResult):
    """Result of `run`, with the record in `folder`: ``print`` shows it in one line.

    A notebook shows it as a table. Its fields are those of `RunResult`, of which a user needs most:

    - `settled`, `cause`: True if the tool has settled at the target; otherwise the reason.
    - `settle_time_s`, `duration_s`: s.
    - `pose`: a `FinalPose`: ``pose.p2_mm``, position (3,) of marker 2 from the RCM; its distance
      from the taught position ``pose.by_joints_mm`` and ``pose.by_image_mm``.
    - `pose_error_mm`, `bound_mm`: true error and its Cramér-Rao bound in a simulation.
    - `drives`: a `DriveResponse`: ``drives.gain`` (3,), measured divided by applied motion, and
      ``drives.lag_ms`` (3,).
    - `backlash`: that of the joints (3,) in rad, rad, mm, fitted to the frames; 0 where they show
      none.
    - `feature_error`: Δs in rad, Δr and Δd in px, rms over the last second.
    - `folder`: folder of the record.
    """

    @property
    def record(self) -> Record:
        """Every tick of the run: ``record.time`` (N,) in s, and ``record.ticks[name]`` (N, size).

        ``print`` shows the names of the columns. `rcmservo.recording.reader.read_record` reads the
        record of a folder later.
        """
        return reader.read_record(Path(self.folder))

    def plot(self) -> Any:
        """Return a Matplotlib figure of the tool's distance (mm) from the taught pose over time."""
        return charts.draw_figure(plots.plot_distance(self.record))

    def save(self, folder: str | Path) -> "RecordedResult":
        """Copy the record into a new folder, with figures and `METRICS_FILE`.

        Returns
        -------
        RecordedResult
            The result with this folder.

        Raises
        ------
        UnusableFile
            If the folder exists or cannot be written.
        """
        destination = Path(folder)
        if destination.exists():
            raise UnusableFile(destination, "exists and is not overwritten: name a new folder")
        try:
            shutil.copytree(self.folder, destination)
        except OSError as error:
            raise UnusableFile(destination, f"cannot be written: {error}") from error
        return save_result(self, self.record, destination)

    def _repr_html_(self) -> str:
        """Return the result as a table for a notebook."""
        rows = "".join(
            f"<tr><td>{escape(title)}</td><td>{escape(text)}</td></tr>"
            for title, text in list_result_rows(self)
        )
        return f"<table><caption>{escape(format_title(self))}</caption>{rows}</table>"


def save_result(result: AnyResult, record: Record | None, folder: Path) -> AnyResult:
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


def _note_failed_write(result: AnyResult, write: Callable[[], None]) -> AnyResult:
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


def remove_empty_record(folder: Path) -> None:
    """Remove the record of a run that did not begin."""
    with suppress(UnusableFile):
        if not reader.has_ticks(folder):
            reader.find_record_file(folder).unlink()
            (folder / METADATA).unlink(missing_ok=True)


def draw_figures(record: Record, folder: Path) -> None:
    """Draw the errors and the estimate over time, unless no tick has an error."""
    if np.isfinite(record.ticks["delta"]).any():
        charts.save_figure(plots.plot_errors(record), folder / "errors.png")
        charts.save_figure(plots.plot_estimate(record), folder / "estimate.png")
