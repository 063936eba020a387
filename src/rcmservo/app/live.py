"""`rcmservo live`: a run in wall time, the arm, its camera and the servo in processes of their
own."""

import json
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rcmservo.app.folders import new_folder
from rcmservo.app.parse import OptionalPath
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.simulator import simulator
from rcmservo.config.files import write_whole
from rcmservo.config.rig_file import Lab, load_lab, told_with
from rcmservo.errors import require
from rcmservo.live.reports import LiveResult, LoopTiming, Report, Spread
from rcmservo.live.supervisor import run_live
from rcmservo.record.reader import RECORD
from rcmservo.servo.servo import Servo

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
    estimator: EstimatorName = "projection"
    """How the Jacobian is learnt; as of `rcmservo run`."""
    rig: OptionalPath = None
    """TOML file with your own mechanism, limits, tool, markers, camera, noise and scene."""
    out: OptionalPath = None
    """Folder to write to, new or empty; by default a new one under runs/."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    boxes: Boxes = field(default_factory=ServoOptions)


@dataclass(frozen=True, eq=False)
class LiveRun:
    """A run that was made, and all that is told of it."""

    options: LiveOptions
    """What was asked for."""
    folder: Path
    """Where it is recorded."""
    result: LiveResult
    """What the supervisor says."""
    pose_error: float
    """‖p₂ − p_d‖ mm at the end, by the simulation's truth."""


def live(options: LiveOptions) -> int:
    """Run, write the folder, print the result; the exit code is 0 where it settled."""
    require(options.seed >= 0, "--seed", options.seed, "a whole number that is not negative")
    good = 1.0 < options.duration <= 3600.0
    require(good, "--duration", options.duration, "more than 1 and at most 3600 s")
    lab = load_lab(options.rig) if options.rig else Lab()
    console = Console(stderr=options.json)
    with simulator("live"), new_folder(options.out, f"live-seed{options.seed}") as folder:
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        console.print(f"[dim]{words}[/dim]")
        run = _run(options, lab, folder, console)
    if options.json:
        print(json.dumps(told(run)))
    else:
        show_live(console, run)
    return 0 if run.result.outcome.settled else UNSETTLED


def _run(options: LiveOptions, lab: Lab, folder: Path, console: Console) -> LiveRun:
    """Run on the simulated bench, and keep what came of it."""
    from rcmservo.app.simulated_run.job import Job, about
    from rcmservo.app.simulated_run.metrics import METRICS
    from rcmservo.app.simulated_run.pictures import draw_figures
    from rcmservo.sim.processes.bench import Bench
    from rcmservo.sim.rig_file import rig_settings

    with told_with(options.rig) if options.rig else nullcontext():
        settings = rig_settings(lab)
    servo, seconds = _servo(options, lab), options.duration
    job = Job(options.seed, seconds, options.estimator, servo, lab, folder)
    with (
        Bench(options.seed, settings) as bench,
        Live(Text(""), console=console, refresh_per_second=8, transient=True) as line,
    ):
        record, words = folder / RECORD, about(job, settings)
        session = bench.session(servo, lab.markers, seconds, record, words)
        result = run_live(session, bench.off, _Progress(line, seconds))
        run = LiveRun(options, folder, result, bench.error())
    write_whole(folder / METRICS, json.dumps(told(run), indent=2) + "\n")
    draw_figures(folder)
    return run


def _servo(options: LiveOptions, lab: Lab) -> Servo:
    boxes = options.boxes
    return Servo(
        mechanism=lab.mechanism,
        tool=lab.tool,
        estimator=boxes.estimators[options.estimator],
        controller=boxes.controller,
        exploration=boxes.exploration,
        imaged_rcm=boxes.imaged_rcm,
        gate=lab.gate,
        thresholds=lab.thresholds,
    )


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


def told(run: LiveRun) -> dict[str, Any]:
    """A run as plain numbers for JSON; None where there is none."""
    outcome, target = run.result.outcome, run.result.target
    error = dict(zip(("s_rad", "r_px", "d_px"), map(_number, outcome.error), strict=True))
    timing = run.result.timing
    return {
        "seed": run.options.seed,
        "estimator": run.options.estimator,
        "folder": str(run.folder),
        "settled": outcome.settled,
        "cause": outcome.cause,
        "settle_time_s": outcome.settle_time if outcome.settled else None,
        "feature_error": error,
        "explored_s": outcome.explored_at,
        "pose_error_mm": _number(run.pose_error),
        "not_recorded": run.result.not_recorded,
        "target_q": None if target is None else target.q.tolist(),
        "loop": None if timing is None else _loop(timing),
    }


def _loop(timing: LoopTiming) -> dict[str, Any]:
    return {
        "ticks": timing.ticks,
        "missed": timing.missed,
        "rate_hz": _number(timing.rate),
        "lateness_ms": _spread(timing.lateness),
        "latency_ms": _spread(timing.latency),
        "collections": timing.collections,
        "refused": timing.refused,
    }


def _spread(spread: Spread) -> dict[str, float | None]:
    return {name: _number(value) for name, value in asdict(spread).items()}


def _number(value: float) -> float | None:
    """A finite number, or None: JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


def show_live(console: Console, run: LiveRun) -> None:
    """The result as a table."""
    outcome = run.result.outcome
    table = Table(title="settled" if outcome.settled else "not settled", show_header=False)
    if outcome.cause:
        table.add_row("cause", Text(outcome.cause))
    settle_time = outcome.settle_time if outcome.settled else None
    table.add_row("settle time", _unit(settle_time, "s", 2))
    table.add_row(
        "pose error ‖p₂ − p_d‖ (simulation's truth)", _unit(_number(run.pose_error), "mm", 3)
    )
    if run.result.timing is not None:
        _show_timing(table, run.result.timing)
    if run.result.not_recorded:
        table.add_row("not recorded", Text(run.result.not_recorded, overflow="fold"))
    table.add_row("files", Text(str(run.folder), overflow="fold"))
    console.print(table)


def _show_timing(table: Table, timing: LoopTiming) -> None:
    missed = f"{timing.missed} of {timing.ticks} ticks missed"
    table.add_row("loop", f"{_unit(_number(timing.rate), 'Hz', 3)}, {missed}")
    late = ", ".join(
        f"{name} {_unit(value, 'ms', 2)}" for name, value in _spread(timing.lateness).items()
    )
    table.add_row("lateness of ticks", f"{late}; {timing.collections} garbage collections")
    latency = ", ".join(
        f"{name} {_unit(value, 'ms', 1)}" for name, value in _spread(timing.latency).items()
    )
    table.add_row("latency, exposure to command", latency)
    for sentence in timing.refused:
        table.add_row("refused", Text(sentence))


def _unit(value: float | None, unit: str, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f} {unit}"
