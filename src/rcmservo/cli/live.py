"""`rcmservo live`: a run in wall time on a simulated lab, or on the devices of a rig file."""

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from rcmservo.cli.folders import open_new_folder, require_new_target_file
from rcmservo.cli.lab.live_on_hardware import live_on_hardware, require_devices
from rcmservo.cli.progress.compilation import report_compilation
from rcmservo.cli.progress.run_progress import LiveProgress
from rcmservo.cli.result_output import print_result, read_record_if_any, save_result
from rcmservo.cli.run_options import RunToTargetOptions
from rcmservo.cli.terminal import open_console, open_status_line
from rcmservo.errors import require, require_extra
from rcmservo.live.supervisor import run_live
from rcmservo.loop.run_result import RunResult, finite_or_none
from rcmservo.recording.reader import RECORD


@dataclass(frozen=True, kw_only=True)
class LiveOptions(RunToTargetOptions):
    """Servo in wall time at 100 Hz.

    The arm, its camera and the servo run in separate processes, and a supervisor watches the servo.
    The lab is simulated unless the rig file has an arm. Then the operator at the terminal confirms
    each step, and nothing moves before.
    """


def live(options: LiveOptions) -> int:
    """Run, write the folder and print the result; return 0 if the run settled."""
    out = open_console(stderr=options.json)
    if options.has_devices():
        require_new_target_file(options.target, options.save_target)
        require_devices(options.lab, options.rig, options.digest)
        _ = options.servo  # invalid settings are refused before anything is written
        with open_new_folder(options.out, "live-hardware") as folder:
            result = live_on_hardware(options, folder, out)
        return print_result(out, result, options.json)
    for name, path in (("--target", options.target), ("--save-target", options.save_target)):
        expected = "left out without [arm] in the rig file: a simulated run teaches its own target"
        require(path is None, name, path, expected)
    with (
        require_extra("live", "sim"),
        open_new_folder(options.out, f"live-seed{options.seed}") as folder,
    ):
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        out.print(words, style="dim", soft_wrap=True)
        result = _run_simulated(options, folder, out)
    return print_result(out, result, options.json)


def _run_simulated(options: LiveOptions, folder: Path, out: Console) -> RunResult:
    """Run on the simulated lab and save the result."""
    from rcmservo.cli.run_description import describe_simulated_run
    from rcmservo.sim.processes.lab_processes import SimulatedLab

    settings, servo, duration = options.rig_settings, options.servo, options.duration
    with open_status_line(out) as line, SimulatedLab(options.seed, settings) as lab:
        with report_compilation(line):  # here, so that the servo process finds the compiled kernels
            servo.warm_up()
        record, description = folder / RECORD, describe_simulated_run(options, duration)
        markers, frames = options.lab.markers, options.teaching_frames
        session = lab.session(servo, markers, duration, record, description, frames)
        result = run_live(session, lab.switch_off, LiveProgress(line, duration))
        error = finite_or_none(lab.true_error())
    result = replace(result, seed=options.seed, estimator=options.estimator, pose_error_mm=error)
    return save_result(result, read_record_if_any(folder), folder)
