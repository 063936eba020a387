"""`rcmservo live`: a run in wall time, the arm, its camera and the servo in processes of their
own."""

import json
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rcmservo.app.folders import new_folder
from rcmservo.app.parse import OptionalPath
from rcmservo.app.preparing import compiling, simulator
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.simulated_run.metrics import METRICS, FeatureError, number
from rcmservo.app.simulated_run.unwritten import written
from rcmservo.app.terminal import console, result_table, unit
from rcmservo.config.files import write_whole
from rcmservo.config.rig_file import Lab, load_lab, told_with
from rcmservo.errors import UnusableFile, require
from rcmservo.live.reports import LiveResult, LoopTiming, Report, Spread
from rcmservo.live.supervisor import run_live
from rcmservo.record import reader
from rcmservo.record.reader import RECORD

UNSETTLED = 1
"""Exit code of a run that did not settle."""


@dataclass(frozen=True)
class LiveOptions:
    """Servo in wall time, at 100 Hz: the simulated arm, its camera and the servo in processes of
    their own, and one that watches."""

    seed: int = 0
    """Draws the camera, the start, the target and the noise."""
    duration: float = 30.0
    """Length of the run, s."""
    estimator: EstimatorName = "dlt"
    """How the Jacobian is learnt; as of `rcmservo run`."""
    rig: OptionalPath = None
    """TOML file with your own mechanism, limits, tool, markers, camera, noise and scene."""
    out: OptionalPath = None
    """Folder to write to, new or empty; by default a new one under runs/."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    boxes: Boxes = field(default_factory=ServoOptions)
    """The settings of the servo's boxes."""


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


@dataclass(frozen=True)
class LiveMetrics:
    """A live run in numbers: what metrics.json holds, by the same names."""

    seed: int
    """What camera, start, target and noise were drawn from."""
    estimator: str
    """The estimator's name on the command line."""
    folder: str
    """Where record, figures and these metrics are."""
    settled: bool
    """Whether the errors stayed small to the end, with nothing wrong then."""
    cause: str
    """Why it did not settle; empty where it did."""
    remark: str
    """What was not as it should be at the end although nothing stopped; empty if all was."""
    settle_time_s: float | None
    """When the errors became small for good; None where the run did not settle."""
    feature_error: FeatureError
    """Of the last second."""
    explored_s: float | None
    """When exploration ended; None where it did not."""
    pose_error_mm: float | None
    """‖p₂ − p_d‖ at the end, by the simulation's truth."""
    not_recorded: str
    """Why the record ends early; empty where it does not."""
    target_q: list[float] | None
    """The joints at which the target was shown."""
    loop: LoopMetrics | None
    """None where the servo's process came to no end."""
    not_written: str = ""
    """Which of the metrics and figures could not be written, and why."""


def live(options: LiveOptions) -> int:
    """Run, write the folder, print the result; the exit code is 0 where it settled."""
    require(options.seed >= 0, "--seed", options.seed, "a whole number that is not negative")
    good = 1.0 < options.duration <= 3600.0
    require(good, "--duration", options.duration, "more than 1 and at most 3600 s")
    lab = load_lab(options.rig) if options.rig else Lab()
    out = console(stderr=options.json)
    with simulator("live"), new_folder(options.out, f"live-seed{options.seed}") as folder:
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        out.print(words, style="dim", soft_wrap=True)
        metrics = _run(options, lab, folder, out)
    if options.json:
        print(json.dumps(asdict(metrics)))
    else:
        show_live(out, metrics)
    return 0 if metrics.settled else UNSETTLED


def _run(options: LiveOptions, lab: Lab, folder: Path, out: Console) -> LiveMetrics:
    """Run on the simulated bench, and keep what came of it."""
    from rcmservo.app.simulated_run.job import Job, about
    from rcmservo.sim.processes.bench import Bench
    from rcmservo.sim.rig_file import rig_settings

    with told_with(options.rig) if options.rig else nullcontext():
        settings = rig_settings(lab)
    servo, seconds = options.boxes.servo(options.estimator, lab), options.duration
    job = Job(options.seed, seconds, options.estimator, servo, lab, folder)
    with (
        Live(Text(""), console=out, refresh_per_second=8, transient=True) as line,
        Bench(options.seed, settings) as bench,
    ):
        with compiling(line):  # here, so that the servo's process finds it done
            servo.warm_up()
        record, words = folder / RECORD, about(job, settings)
        session = bench.session(servo, lab.markers, seconds, record, words)
        result = run_live(session, bench.off, _Progress(line, seconds))
        metrics = metrics_of(options, folder, result, bench.error())
    return kept(folder, metrics)


def kept(folder: Path, metrics: LiveMetrics) -> LiveMetrics:
    """The metrics, written with the figures; of a record that holds nothing there are none."""
    from rcmservo.app.simulated_run.pictures import draw_figures

    with suppress(UnusableFile):
        record = reader.read(folder)
        metrics = written(metrics, lambda: draw_figures(record, folder))
    text = json.dumps(asdict(metrics), indent=2) + "\n"
    return written(metrics, lambda: write_whole(folder / METRICS, text))


class _Progress:
    """Shows how a run goes: a live line, and a lasting one for every new phase or cause."""

    def __init__(self, line: Live, duration: float) -> None:
        self._line, self._duration, self._said = line, duration, ""

    def __call__(self, report: Report) -> None:
        time = report.time * 1e-9
        if report.words != self._said:
            self._said = report.words
            words = f"{time:6.2f} s  {report.words}"
            self._line.console.print(words, soft_wrap=True, highlight=False)
        self._line.update(
            Text(f"{time:6.2f} / {self._duration:g} s  {report.words}"), refresh=False
        )


def metrics_of(
    options: LiveOptions, folder: Path, result: LiveResult, pose_error: float
) -> LiveMetrics:
    """What the supervisor says of a run, and its pose error by the simulation's truth."""
    outcome, target, timing = result.outcome, result.target, result.timing
    return LiveMetrics(
        seed=options.seed,
        estimator=options.estimator,
        folder=str(folder),
        settled=outcome.settled,
        cause=outcome.cause,
        remark=outcome.remark,
        settle_time_s=outcome.settle_time if outcome.settled else None,
        feature_error=FeatureError(*map(number, outcome.error)),
        explored_s=outcome.explored_at,
        pose_error_mm=number(pose_error),
        not_recorded=result.not_recorded,
        target_q=None if target is None else target.q.tolist(),
        loop=None if timing is None else _loop(timing),
    )


def _loop(timing: LoopTiming) -> LoopMetrics:
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


def show_live(out: Console, metrics: LiveMetrics) -> None:
    """The result as a table, and where its files are."""
    table = result_table(metrics.settled, metrics.cause)
    if metrics.remark:
        table.add_row("at the end", metrics.remark)
    table.add_row("settle time", unit(metrics.settle_time_s, "s", 2))
    pose = unit(metrics.pose_error_mm, "mm", 3)
    table.add_row("pose error ‖p₂ − p_d‖ (simulation's truth)", pose)
    if metrics.loop is not None:
        _add_loop(table, metrics.loop)
    if metrics.not_recorded:
        table.add_row("not recorded", metrics.not_recorded)
    if metrics.not_written:
        table.add_row("not written", metrics.not_written)
    out.print(table)
    out.print(f"files in {metrics.folder}", soft_wrap=True)


def _add_loop(table: Table, loop: LoopMetrics) -> None:
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
