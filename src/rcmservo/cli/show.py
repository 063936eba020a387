"""`rcmservo show`: a recorded run as a summary, a timeline in words, and figures."""

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

from rcmservo.cli.folders import open_new_folder
from rcmservo.cli.result_output import build_two_column_table
from rcmservo.cli.terminal import open_console
from rcmservo.config.atomic_files import write_atomically
from rcmservo.figures import charts, plots
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.reader import Record
from rcmservo.recording.summary_text import (
    describe_cause,
    describe_way_out,
    format_verdict,
    list_record_rows,
)
from rcmservo.recording.timeline import Span, list_spans, summarise
from rcmservo.safety.causes import Action

FIRST_SPANS = 40
"""Number of spans from the beginning that the timeline shows."""
LAST_SPANS = 20
"""Number of spans from the end that a longer timeline shows as well."""

ACTION_STYLES = {
    Action.NONE: "",
    Action.WARN: "",
    Action.SLOW: "cyan",
    Action.HOLD: "yellow",
    Action.PAUSE: "dark_orange",
    Action.FAULT: "bold red",
}
"""Style of a span in the timeline, by the action that its cause requires."""


@dataclass(frozen=True)
class ShowOptions:
    """Report a recorded run: a summary, a timeline of phases and causes, and figures.

    Parameters
    ----------
    record : Path
        Folder of a run, or an .mcap file.
    out : Path or None
        New or empty folder for the figures; by default a new one under runs/.
    """

    record: Annotated[Path, tyro.conf.Positional]
    out: Path | None = None


def show(options: ShowOptions) -> int:
    """Print and draw a record and return the exit code 0."""
    record = reader.read_record(options.record)
    out = open_console()
    with open_new_folder(options.out, "show") as folder:
        print_record(out, record)
        write_figures(record, folder)
    drawn = any(folder.glob("*.png"))
    words = (
        f"figures and timeline.csv in {folder}"
        if drawn
        else f"timeline.csv in {folder}; the record holds no data for figures"
    )
    out.print(words, soft_wrap=True)
    return 0


def print_record(out: Console, record: Record) -> None:
    """Print the summary and the timeline of a record."""
    found = list_spans(record)
    out.print(_build_summary_table(record, summarise(record)))
    if found:
        out.print(_build_timeline_table(found))


def write_figures(record: Record, folder: Path) -> None:
    """Write the figures of a record, and its complete timeline as a table."""
    write_atomically(folder / "timeline.csv", _format_timeline_csv(list_spans(record)))
    if np.isfinite(record.ticks["delta"]).any():
        charts.save_figure(plots.plot_timeline(record), folder / "timeline.png")
        charts.save_figure(plots.plot_path(record), folder / "path.png")
        charts.save_figure(plots.plot_errors(record), folder / "errors.png")
        charts.save_figure(plots.plot_estimate(record), folder / "estimate.png")


def _build_summary_table(record: Record, result: RunResult) -> Table:
    rows = [("record", str(record.path)), *list_record_rows(record, result)]
    if record.missing:
        rows.insert(0, ("missing", record.missing))
    return build_two_column_table(format_verdict(record, result), rows)


def _build_timeline_table(found: list[Span]) -> Table:
    """Return a table with one row per span; a long timeline is cut in the middle."""
    table = Table(title="timeline", title_justify="left")
    for title in ("start", "length"):
        table.add_column(title, justify="right", no_wrap=True)
    for title in ("phase", "why", "way out")[: 3 if any(map(describe_cause, found)) else 1]:
        table.add_column(title)
    several = found[-1].stage > 0
    left_out = len(found) - FIRST_SPANS - LAST_SPANS
    for i, span in enumerate(found):
        if left_out > 0 and i == FIRST_SPANS:
            table.add_row("…", "…", f"… {left_out} more, in timeline.csv")
        if left_out > 0 and FIRST_SPANS <= i < FIRST_SPANS + left_out:
            continue
        begins_stage = several and (i == 0 or found[i - 1].stage != span.stage)
        if begins_stage and i:
            table.add_section()
        phase = f"stage {span.stage + 1}: {span.phase.value}" if begins_stage else span.phase.value
        words = [
            Text(phase, ACTION_STYLES[span.action]),
            Text(describe_cause(span), ACTION_STYLES[span.action]),
            Text(describe_way_out(span)),
        ]
        table.add_row(
            f"{span.start:.2f} s", f"{span.duration:.2f} s", *words[: len(table.columns) - 2]
        )
    return table


def _format_timeline_csv(found: list[Span]) -> str:
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
                span.action.name,
                span.request.name,
                span.why,
                span.cause.remedy,
            )
        )
    return text.getvalue()
