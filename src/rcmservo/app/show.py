"""`rcmservo show`: a recorded run for a person, as a summary, a timeline in words, and figures."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rcmservo.app.folders import new_folder
from rcmservo.app.parse import OptionalPath
from rcmservo.app.terminal import console
from rcmservo.config.files import write_whole
from rcmservo.figures import charts, plots
from rcmservo.guard.causes import Action, Cause
from rcmservo.guard.states import Request
from rcmservo.record import reader
from rcmservo.record.reader import Record
from rcmservo.record.timeline import RunSummary, Span, spans, summary

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
    figures."""

    record: Annotated[Path, tyro.conf.Positional]
    """A run's folder, or an .mcap file."""
    out: OptionalPath = None
    """Folder to write the figures to, new or empty; by default a new one under runs/."""


def show(options: ShowOptions) -> int:
    rows = reader.read(options.record)
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
        charts.save(plots.timeline(record), folder / "timeline.png")
        charts.save(plots.path(record), folder / "path.png")
        charts.save(plots.errors(record), folder / "errors.png")
        charts.save(plots.estimate(record), folder / "estimate.png")


def _summary(record: Record, told: RunSummary) -> Table:
    outcome = told.outcome
    verdict = "settled" if outcome.settled else "not settled"
    so_far = ", as far as the record can be read" if record.missing else ""
    table = Table(title=verdict + so_far, show_header=False)
    if record.missing:
        table.add_row("missing", Text(record.missing, "bold red"))
    table.add_row("record", Text(str(record.path), overflow="fold"))
    table.add_row("what", Text(_what(record)))
    if outcome.cause:
        table.add_row("cause", Text(outcome.cause))
    if outcome.remark:
        table.add_row("at the end", Text(outcome.remark))
    if outcome.settle_time is not None:
        table.add_row("settle time", f"{outcome.settle_time:.2f} s")
    table.add_row("duration", f"{told.duration:.2f} s, {_count(told.ticks, 'tick')}")
    if len(record.stages) > 1:
        table.add_row("stages", _stages(record))
    if np.isfinite(outcome.error).all():
        s, r, d = np.degrees(outcome.error[0]), outcome.error[1], outcome.error[2]
        words = f"s {s:.3f} °, r {r:.2f} px, d {d:.2f} px"
        table.add_row("feature error (rms, last second)", words)
    if np.isfinite(told.latency).all():
        median, high, worst = told.latency * 1e3
        table.add_row(
            "latency, exposure to tick",
            f"median {median:.1f} ms, p99 {high:.1f} ms, at most {worst:.1f} ms",
        )
    table.add_row("late ticks", f"{told.late}, at most {told.longest * 1e3:.1f} ms between two")
    table.add_row("frames", _frames(told))
    return table


def _what(record: Record) -> str:
    """Of which arm, by which estimator, drawn from which seed and by which version."""
    about = record.about
    parts = ["simulation" if about.get("simulation") else "run"]
    if "seed" in about:
        parts[0] += f" with seed {about['seed']}"
    servo: Any = record.stages[-1].servo if record.stages else {}
    for box in ("mechanism", "tool", "estimator"):
        try:
            parts.append(f"{box} {servo[box]['kind']}")
        except (KeyError, TypeError):
            continue
    versions: Any = about.get("versions")
    if isinstance(versions, dict) and "rcmservo" in versions:
        parts.append(f"rcmservo {versions['rcmservo']}")
    return ", ".join(parts)


def _stages(record: Record) -> str:
    """How many stages the record holds, and when each of them began."""
    count = len(record.time)
    begun = [f"{record.time[stage.first]:.2f} s" for stage in record.stages if stage.first < count]
    return f"{len(record.stages)}, begun at {', '.join(begun)}"


def _frames(told: RunSummary) -> str:
    parts = [f"{told.seen} used"]
    if told.skipped:
        parts.append(f"{told.skipped} passed over")
    if told.disbelieved:
        parts.append(f"{told.disbelieved} not believed")
    parts += [
        f"{reason.value} at {_count(count, 'tick')}" for reason, count in told.dropped.items()
    ]
    return ", ".join(parts)


def _count(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def _timeline(found: list[Span]) -> Table:
    """A row for every span; of many the first and the last ones."""
    table = Table(title="timeline", title_justify="left")
    for title in ("start", "length"):
        table.add_column(title, justify="right", no_wrap=True)
    for title in ("phase", "why", "way out")[: 3 if any(map(_why, found)) else 1]:
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
            Text(_why(span), LOOKS[span.asks]),
            Text(_way_out(span)),
        ]
        table.add_row(
            f"{span.start:.2f} s", f"{span.length:.2f} s", *words[: len(table.columns) - 2]
        )
    return table


def _why(span: Span) -> str:
    """The cause, after what a person asked for."""
    if span.request is Request.NONE or span.cause is Cause.ASKED:
        return span.why
    asked = f"after a person's {span.request.value}"
    return f"{asked}: {span.why}" if span.cause is not Cause.NONE else asked


def _way_out(span: Span) -> str:
    """What a person can do, where the tool stands still until then."""
    return span.cause.way_out if span.asks >= Action.HOLD else ""


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
                f"{span.length:.4f}",
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
