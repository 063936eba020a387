"""A live run as it is told: how it goes, how its loop kept its time, and what is kept of it. The
same for simulated devices and for those of a laboratory."""

import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from rich.live import Live
from rich.table import Table
from rich.text import Text

from rcmservo.app.run_figures import draw_figures
from rcmservo.app.simulated_run.metrics import METRICS, number
from rcmservo.app.simulated_run.unwritten import written
from rcmservo.app.terminal import unit
from rcmservo.config.files import write_whole
from rcmservo.errors import UnusableFile
from rcmservo.live.reports import LoopTiming, Report, Spread
from rcmservo.record import reader
from rcmservo.record.ros2_bag import METADATA

Metrics = TypeVar("Metrics")


@dataclass(frozen=True)
class SpreadMetrics:
    """How a time was spread over a run, ms; None where it never came up."""

    median: float | None
    """Half of the times were no longer."""
    p99: float | None
    """The 99th percentile."""
    max: float | None
    """The longest."""


@dataclass(frozen=True)
class LoopMetrics:
    """How the loop kept its time."""

    ticks: int
    """How many there were."""
    missed: int
    """Ticks that the loop was not there to begin."""
    rate_hz: float | None
    """Ticks a second, the mean; None where there were fewer than two."""
    lateness_ms: SpreadMetrics
    """From when a tick was due until it began."""
    latency_ms: SpreadMetrics
    """From a frame's exposure to the command that it led to."""
    collections: int
    """How often the collection of garbage stopped the process."""
    refused: list[str]
    """What the operating system would not do, in sentences."""


class Progress:
    """Shows how a run goes: a live line, and a lasting one for every new phase or cause.
    The live line begins with the first report."""

    def __init__(self, line: Live, duration: float) -> None:
        self._line, self._duration, self._said = line, duration, ""

    def __call__(self, report: Report) -> None:
        self._line.start()
        time = report.time * 1e-9
        if report.words != self._said:
            self._said = report.words
            words = f"{time:6.2f} s  {report.words}"
            self._line.console.print(words, soft_wrap=True, highlight=False)
        self._line.update(
            Text(f"{time:6.2f} / {self._duration:g} s  {report.words}"), refresh=False
        )


def kept(folder: Path, metrics: Metrics) -> Metrics:
    """The metrics, written with the figures; of a record that holds nothing there are none."""
    with suppress(UnusableFile):
        record = reader.read(folder)
        metrics = written(metrics, lambda: draw_figures(record, folder))
    text = json.dumps(asdict(cast(Any, metrics)), indent=2) + "\n"
    return written(metrics, lambda: write_whole(folder / METRICS, text))


def drop_empty(folder: Path) -> None:
    """Remove the record of a run that did not begin."""
    with suppress(UnusableFile):
        if not reader.begun(folder):
            reader.file_of(folder).unlink()
            (folder / METADATA).unlink(missing_ok=True)


def loop_metrics(timing: LoopTiming) -> LoopMetrics:
    """How the loop kept its time, as metrics."""
    return LoopMetrics(
        timing.ticks,
        timing.missed,
        number(timing.rate),
        _spread(timing.lateness),
        _spread(timing.latency),
        timing.collections,
        timing.refused,
    )


def _spread(spread: Spread) -> SpreadMetrics:
    return SpreadMetrics(number(spread.median), number(spread.p99), number(spread.max))


def add_loop(table: Table, loop: LoopMetrics) -> None:
    """Rows that tell how the loop kept its time."""
    missed = f"{loop.missed} of {loop.ticks} ticks missed"
    table.add_row("loop", f"{unit(loop.rate_hz, 'Hz', 3)}, {missed}")
    late = _words(loop.lateness_ms, 2)
    table.add_row("lateness of ticks", f"{late}; {loop.collections} garbage collections")
    table.add_row("latency, exposure to command", _words(loop.latency_ms, 1))
    for sentence in loop.refused:
        table.add_row("refused", sentence)


def _words(spread: SpreadMetrics, digits: int) -> str:
    parts = ("median", spread.median), ("p99", spread.p99), ("max", spread.max)
    return ", ".join(f"{name} {unit(value, 'ms', digits)}" for name, value in parts)
