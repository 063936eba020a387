"""`rcmservo live`: a run in wall time, the arm, its camera and the servo in processes of their own;
of a laboratory's devices where the rig file names an arm."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from rcmservo.app.folders import new_folder, require_new
from rcmservo.app.lab.live_on_hardware import live_on_hardware, require_devices, show_hardware
from rcmservo.app.lab.live_told import LoopMetrics, Progress, add_loop, kept, loop_metrics
from rcmservo.app.lab_options import RunToTargetOptions
from rcmservo.app.simulated_run.metrics import FeatureError, number
from rcmservo.app.terminal import console, live_line, print_result, result_table, unit
from rcmservo.app.waiting.preparing import compiling
from rcmservo.errors import needing, require
from rcmservo.live.reports import LiveResult
from rcmservo.live.supervisor import run_live
from rcmservo.record.reader import RECORD


@dataclass(frozen=True, kw_only=True)
class LiveOptions(RunToTargetOptions):
    """Servo in wall time, at 100 Hz: the arm, its camera and the servo in processes of their own,
    and one that watches. Simulated, unless the rig file names an arm: then a person at the terminal
    is asked at each step, and nothing moves before."""


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
    out = console(stderr=options.json)
    if options.has_devices():
        require_new(options.target, options.save_target)
        require_devices(options.lab, options.rig, options.digest)
        _ = options.servo  # is refused here, before anything is written
        with new_folder(options.out, "live-hardware") as folder:
            metrics = live_on_hardware(options, folder, out)
        return print_result(metrics, options.json, show_hardware)
    for name, path in (("--target", options.target), ("--save-target", options.save_target)):
        right = "left out where no [arm] is given: a simulated arm is shown its target"
        require(path is None, name, path, right)
    with needing("live", "sim"), new_folder(options.out, f"live-seed{options.seed}") as folder:
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        out.print(words, style="dim", soft_wrap=True)
        metrics = _run(options, folder, out)
    return print_result(metrics, options.json, show_live)


def _run(options: LiveOptions, folder: Path, out: Console) -> LiveMetrics:
    """Run on the simulated bench, and keep what came of it."""
    from rcmservo.app.simulated_run.about import about
    from rcmservo.sim.processes.lab_processes import Bench

    settings, servo, seconds = options.rig_settings, options.servo, options.duration
    with live_line(out) as line, Bench(options.seed, settings) as bench:
        with compiling(line):  # here, so that the servo's process finds it done
            servo.warm_up()
        record, words = folder / RECORD, about(options, seconds)
        markers, frames = options.lab.markers, options.teaching_frames
        session = bench.session(servo, markers, seconds, record, words, frames)
        result = run_live(session, bench.off, Progress(line, seconds))
        metrics = metrics_of(options, folder, result, bench.error())
    return kept(folder, metrics)


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
        loop=None if timing is None else loop_metrics(timing),
    )


def show_live(out: Console, metrics: LiveMetrics) -> None:
    """The result as a table, and where its files are."""
    table = result_table(metrics.settled, metrics.cause)
    if metrics.remark:
        table.add_row("at the end", metrics.remark)
    table.add_row("settle time", unit(metrics.settle_time_s, "s", 2))
    pose = unit(metrics.pose_error_mm, "mm", 3)
    table.add_row("pose error ‖p₂ − p_d‖ (simulation's truth)", pose)
    if metrics.loop is not None:
        add_loop(table, metrics.loop)
    if metrics.not_recorded:
        table.add_row("not recorded", metrics.not_recorded)
    if metrics.not_written:
        table.add_row("not written", metrics.not_written)
    out.print(table)
    out.print(f"files in {metrics.folder}", soft_wrap=True)
