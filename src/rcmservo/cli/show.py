"""`rcmservo show`: a recorded run for a person, as a summary, a timeline in words, and figures."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rcmservo.cli.folders import new_folder
from rcmservo.cli.result_output import table
from rcmservo.cli.terminal import console
from rcmservo.config.atomic_files import write_whole
from rcmservo.figures import charts, plots
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.reader import Record
from rcmservo.recording.summary_text import rows_of, verdict_of, way_out, why
from rcmservo.recording.timeline import Span, spans, summary
from rcmservo.safety.causes import Action

MOST = 40
"""Spans that the timeline shows from the beginning; of a longer one also the LAST."""
LAST = 20

LOOKS = {
    Action.NONE: "",
    Action.WARN: "",
    Action.SLOW: "cyan",
    Action.HOLD: "yellow",
    Action.PAUSE: "dark_orange",
    Action.FAULT: "bold red",
}


@dataclass(frozen=True)
class ShowOptions:
    """Tell what happened in a recorded run: a summary, a timeline of phases and causes, and
    figures.

    Parameters
    ----------
    record : Path
        A run's folder, or an .mcap file.
    out : Path or None
        Folder to write the figures to, new or empty; by default a new one under runs/.
    """

    record: Annotated[Path, tyro.conf.Positional]
    out: Path | None = None


def show(options: ShowOptions) -> int:
    rows = reader.read_record(options.record)
    out = console()
    with new_folder(options.out, "show") as folder:
        tell(out, rows)
        draw(rows, folder)
    drawn = any(folder.glob("*.png"))
    words = (
        f"figures and timeline.csv in {folder}"
        if drawn
        else f"timeline.csv in {folder}; there was nothing to draw"
    )
    out.print(words, soft_wrap=True)
    return 0


def tell(out: Console, record: Record) -> None:
    """Print the summary and the timeline of a record."""
    found = spans(record)
    out.print(_summary(record, summary(record)))
    if found:
        out.print(_timeline(found))


def draw(record: Record, folder: Path) -> None:
    """Write the figures of a record, and its whole timeline as a table."""
    write_whole(folder / "timeline.csv", _csv(spans(record)))
    if np.isfinite(record.ticks["delta"]).any():
        charts.save_figure(plots.plot_timeline(record), folder / "timeline.png")
        charts.save_figure(plots.plot_path(record), folder / "path.png")
        charts.save_figure(plots.plot_errors(record), folder / "errors.png")
        charts.save_figure(plots.plot_estimate(record), folder / "estimate.png")


def _summary(record: Record, result: RunResult) -> Table:
    rows = [("record", str(record.path)), *rows_of(record, result)]
    if record.missing:
        rows.insert(0, ("missing", record.missing))
    return table(verdict_of(record, result), rows)


def _timeline(found: list[Span]) -> Table:
    """A row for every span; of many the first and the last ones."""
    table = Table(title="timeline", title_justify="left")
    for title in ("start", "length"):
        table.add_column(title, justify="right", no_wrap=True)
    for title in ("phase", "why", "way out")[: 3 if any(map(why, found)) else 1]:
        table.add_column(title)
    several = found[-1].stage > 0
    left_out = len(found) - MOST - LAST
    for i, span in enumerate(found):
        if left_out > 0 and i == MOST:
            table.add_row("…", "…", f"… {left_out} more, in timeline.csv")
        if left_out > 0 and MOST <= i < MOST + left_out:
            continue
        new = several and (i == 0 or found[i - 1].stage != span.stage)
        if new and i:
            table.add_section()
        phase = f"stage {span.stage + 1}: {span.phase.value}" if new else span.phase.value
        words = [
            Text(phase, LOOKS[span.asks]),
            Text(why(span), LOOKS[span.asks]),
            Text(way_out(span)),
        ]
        table.add_row(
            f"{span.start:.2f} s", f"{span.duration:.2f} s", *words[: len(table.columns) - 2]
        )
    return table


def _csv(found: list[Span]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        (
            "start [s]",
            "length [s]",
            "stage",
            "phase",
            "cause",
            "action",
            "request",
            "words",
            "way out",
        )
    )
    for span in found:
        writer.writerow(
            (
                f"{span.start:.4f}",
                f"{span.duration:.4f}",
                span.stage + 1,
                span.phase.name,
                span.cause.name,
                span.asks.name,
                span.request.name,
                span.why,
                span.cause.way_out,
            )
        )
    return text.getvalue()
