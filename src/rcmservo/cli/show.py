"""`rcmservo show`: summary, timeline in words, and figures of a recorded run.

A record consists of stages: a new stage begins when the servo's settings or the target change, or
when the loop restarts. The timeline divides each stage into spans, each with one phase (such as
SERVO or PAUSED) and one cause (such as a lost marker).
"""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.table import Table
from rich.text import Text

from rcmservo.cli.terminal import build_two_column_table, open_console
from rcmservo.config.atomic_files import write_atomically
from rcmservo.config.new_folder import open_new_folder
from rcmservo.figures import charts, plots
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.reader import Record
from rcmservo.recording.summary_text import (
    describe_cause,
    describe_remedy,
    format_verdict,
    list_record_rows,
)
from rcmservo.recording.timeline import Span, list_spans, summarise_record
from rcmservo.rig.result import draw_figures
from rcmservo.safety.causes import Action

FIRST_SPAN_COUNT = 40
"""Number of spans at the beginning of a long timeline that are printed."""
LAST_SPAN_COUNT = 20
"""Number of spans at the end of a long timeline that are printed."""

CSV_HEADER = "start [s],length [s],stage,phase,cause,action,request,words,way out\n"
"""Columns of timeline.csv, one row per span.

`words` is the cause with its detail, and `way out` its remedy, whatever action was taken. The
printed timeline has the remedy only for spans in which the tool waits for it.
"""

ACTION_STYLES = {
    Action.SLOW: "cyan",
    Action.HOLD: "yellow",
    Action.PAUSE: "dark_orange",
    Action.FAULT: "bold red",
}
"""Style of a span in the printed timeline, by the action taken; other actions have no style."""


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
    """Print summary and timeline of a record, write its files, and return the exit code 0.

    Parameters
    ----------
    options : ShowOptions
        Record, and folder for timeline.csv and the figures.

    Returns
    -------
    int
        Exit code 0.

    Raises
    ------
    UnusableFile
        If the record cannot be read, or `out` is not empty or cannot be written to.
    """
    record, console = reader.read_record(options.record), open_console()
    with open_new_folder(options.out, "show") as folder:
        spans = list_spans(record)
        console.print(_build_summary_table(record, summarise_record(record)))
        if spans:
            console.print(_build_timeline_table(spans))
        has_figures = _write_timeline_and_figures(record, spans, folder)
    if has_figures:
        console.print(f"figures and timeline.csv in {folder}", soft_wrap=True)
    else:
        reason = "the record holds no data for figures"
        console.print(f"timeline.csv in {folder}; {reason}", soft_wrap=True)
    return 0


def _write_timeline_and_figures(record: Record, spans: list[Span], folder: Path) -> bool:
    """Write timeline.csv and the figures; return False if the record has no data for figures."""
    write_atomically(folder / "timeline.csv", _format_timeline_csv(spans))
    if not np.isfinite(record.ticks["delta"]).any():
        return False
    charts.save_figure(plots.plot_timeline(record), folder / "timeline.png")
    charts.save_figure(plots.plot_path(record), folder / "path.png")
    draw_figures(record, folder)
    return True


def _build_summary_table(record: Record, result: RunResult) -> Table:
    rows = [("record", str(record.path)), *list_record_rows(record, result)]
    if record.missing:
        rows.insert(0, ("missing", record.missing))
    return build_two_column_table(format_verdict(record, result), rows)


def _build_timeline_table(spans: list[Span]) -> Table:
    """Return a table with one row per span.

    If there are too many, one row with the number of omitted spans replaces those in the middle.
    The first span of a stage states its number if the record has several. The columns for cause
    and remedy are left out if no span has a cause.
    """
    table = Table(title="timeline", title_justify="left")
    for title in ("start", "length"):
        table.add_column(title, justify="right", no_wrap=True)
    has_causes = any(map(describe_cause, spans))
    for title in ("phase", "cause", "remedy") if has_causes else ("phase",):
        table.add_column(title)
    has_several_stages = spans[-1].stage > 0
    omitted_count = len(spans) - FIRST_SPAN_COUNT - LAST_SPAN_COUNT
    for i, span in enumerate(spans):
        if omitted_count > 0 and i == FIRST_SPAN_COUNT:
            table.add_row("…", "…", f"… {omitted_count} more, in timeline.csv")
        if omitted_count > 0 and FIRST_SPAN_COUNT <= i < FIRST_SPAN_COUNT + omitted_count:
            continue
        begins_stage = has_several_stages and (i == 0 or spans[i - 1].stage != span.stage)
        if begins_stage and i:
            table.add_section()
        phase = f"stage {span.stage + 1}: {span.phase.value}" if begins_stage else span.phase.value
        style = ACTION_STYLES.get(span.action, "")
        cause, remedy = Text(describe_cause(span), style), Text(describe_remedy(span))
        cells = f"{span.start:.2f} s", f"{span.duration:.2f} s", Text(phase, style), cause, remedy
        table.add_row(*cells[: len(table.columns)])
    return table


def _format_timeline_csv(spans: list[Span]) -> str:
    """Return all spans as comma-separated values (CSV), under `CSV_HEADER`."""
    buffer = io.StringIO()
    buffer.write(CSV_HEADER)
    writer = csv.writer(buffer, lineterminator="\n")
    for span in spans:
        times_s = f"{span.start:.4f}", f"{span.duration:.4f}"
        states = span.phase, span.cause, span.action, span.request
        state_names = (state.name for state in states)
        writer.writerow((*times_s, span.stage + 1, *state_names, span.why, span.cause.remedy))
    return buffer.getvalue()
