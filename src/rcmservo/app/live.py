"""`rcmservo live`: a run in wall time, the arm, its camera and the servo in processes of their own;
of a laboratory's devices where the rig file names an arm."""

from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.text import Text

from rcmservo.app.folders import new_folder, require_new
from rcmservo.app.lab.live_on_hardware import HardwareJob, live_on_hardware, require_devices
from rcmservo.app.lab.live_progress import LiveProgress
from rcmservo.app.parse import OptionalPath
from rcmservo.app.result_output import record_in, report, save_result
from rcmservo.app.servo_options import Boxes, EstimatorName, ServoOptions
from rcmservo.app.terminal import console
from rcmservo.app.waiting.preparing import compiling
from rcmservo.config.checked import digest_of
from rcmservo.config.rig_file import Lab, bytes_of, lab_of, told_with
from rcmservo.errors import needing, require
from rcmservo.live.supervisor import run_live
from rcmservo.loop.run_result import RunResult, known
from rcmservo.loop.shown import TEACHING_FRAMES, require_frames
from rcmservo.record.reader import RECORD


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
        result = _run(options, lab, folder, out)
    return report(out, result, options.json)


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
        result = live_on_hardware(job, out)
    return report(out, result, options.json)


def _run(options: LiveOptions, lab: Lab, folder: Path, out: Console) -> RunResult:
    """Run on the simulated bench, and keep the result."""
    from rcmservo.app.simulated_run.job import Job, about
    from rcmservo.sim.processes.bench import Bench
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
        result = run_live(session, bench.off, LiveProgress(line, seconds))
        error = known(bench.error())
    result = replace(result, seed=options.seed, estimator=options.estimator, pose_error_mm=error)
    return save_result(result, record_in(folder), folder)
