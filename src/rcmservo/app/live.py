"""`rcmservo live`: a run in wall time, the arm, its camera and the servo in processes of their own;
of a laboratory's devices where the rig file names an arm."""

import json
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.text import Text

from rcmservo.app.folders import new_folder, require_new
from rcmservo.app.lab.live_on_hardware import (
    HardwareJob,
    live_on_hardware,
    require_devices,
    show_hardware,
)
from rcmservo.app.lab.live_told import LoopMetrics, Progress, add_loop, kept, loop_metrics
from rcmservo.app.parse import OptionalPath
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.simulated_run.metrics import FeatureError, number
from rcmservo.app.terminal import console, result_table, unit
from rcmservo.app.waiting.preparing import compiling
from rcmservo.config.checked import digest_of
from rcmservo.config.rig_file import Lab, bytes_of, lab_of, told_with
from rcmservo.errors import needing, require
from rcmservo.live.reports import LiveResult
from rcmservo.live.supervisor import run_live
from rcmservo.loop.shown import TEACHING_FRAMES, require_frames
from rcmservo.record.reader import RECORD

UNSETTLED = 1
"""Exit code of a run that did not settle."""


@dataclass(frozen=True)
class LiveOptions:
    """Servo in wall time, at 100 Hz: the arm, its camera and the servo in processes of their own,
    and one that watches. Simulated, unless the rig file names an arm: then a person at the terminal
    is asked at each step, and nothing moves before."""

    seed: int = 0
    """Draws the camera, the start, the target and the noise."""
    duration: float = 30.0
    """Length of the run, s."""
    estimator: EstimatorName = "dlt"
    """The estimator of the Jacobian: one of those below, or your own."""
    rig: OptionalPath = None
    """TOML file with your own mechanism, limits, tool, markers, camera, noise and scene; or with
    your own devices, [arm] and [camera] with a kind."""
    target: OptionalPath = None
    """File with the target, as --save-target wrote it, for your own devices; by default the target
    is shown by hand."""
    save_target: OptionalPath = None
    """New file to keep the target in that was shown, for your own devices."""
    teaching_frames: int = TEACHING_FRAMES
    """Frames that a target is the mean of: 300 are 5 s at 60 frames/s."""
    out: OptionalPath = None
    """Folder to write to, new or empty; by default a new one under runs/."""
    json: bool = False
    """Print one JSON object on stdout and nothing else."""
    boxes: Boxes = field(default_factory=ServoOptions)
    """The settings of the servo's boxes."""


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
    require_frames(options.teaching_frames, "--teaching-frames")
    data = b"" if options.rig is None else bytes_of(options.rig)
    lab = Lab() if options.rig is None else lab_of(options.rig, data)
    out = console(stderr=options.json)
    if options.rig is not None and "arm" in lab.devices:
        return _on_hardware(options, options.rig, lab, digest_of(data), out)
    for name, path in (("--target", options.target), ("--save-target", options.save_target)):
        right = "left out where no [arm] is given: a simulated arm is shown its target"
        require(path is None, name, path, right)
    with needing("live", "sim"), new_folder(options.out, f"live-seed{options.seed}") as folder:
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        out.print(words, style="dim", soft_wrap=True)
        metrics = _run(options, lab, folder, out)
    if options.json:
        print(json.dumps(asdict(metrics)))
    else:
        show_live(out, metrics)
    return 0 if metrics.settled else UNSETTLED


def _on_hardware(options: LiveOptions, rig: Path, lab: Lab, digest: str, out: Console) -> int:
    """Run with the devices of a rig file, print the result; the exit code as of `live`."""
    require(options.seed == 0, "--seed", options.seed, f"left out: nothing is simulated of {rig}")
    require_new(options.target, options.save_target)
    require_devices(lab, rig, digest)
    servo = options.boxes.servo(options.estimator, lab)
    with new_folder(options.out, "live-hardware") as folder:
        job = HardwareJob(
            servo,
            options.estimator,
            options.duration,
            lab,
            rig,
            digest,
            folder,
            options.target,
            options.save_target,
            options.teaching_frames,
        )
        metrics = live_on_hardware(job, out)
    if options.json:
        print(json.dumps(asdict(metrics)))
    else:
        show_hardware(out, metrics)
    return 0 if metrics.settled else UNSETTLED


def _run(options: LiveOptions, lab: Lab, folder: Path, out: Console) -> LiveMetrics:
    """Run on the simulated bench, and keep what came of it."""
    from rcmservo.app.simulated_run.job import Job, about
    from rcmservo.sim.processes.lab_processes import Bench
    from rcmservo.sim.rig_file import rig_settings

    with told_with(options.rig) if options.rig else nullcontext():
        settings = rig_settings(lab)
    servo, seconds = options.boxes.servo(options.estimator, lab), options.duration
    frames = options.teaching_frames
    job = Job(options.seed, seconds, options.estimator, servo, lab, folder, teaching_frames=frames)
    with (
        Live(Text(""), console=out, refresh_per_second=8, transient=True) as line,
        Bench(options.seed, settings) as bench,
    ):
        with compiling(line):  # here, so that the servo's process finds it done
            servo.warm_up()
        record, words = folder / RECORD, about(job, settings)
        session = bench.session(servo, lab.markers, seconds, record, words, frames)
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
