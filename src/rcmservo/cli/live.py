"""`rcmservo live`: a run in wall time on a simulated arm, or on the devices of a rig file.

Its options are `LiveOptions` and, shared with `run`, those of run_options.py.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from rcmservo.cli.lab.live_on_hardware import live_on_hardware
from rcmservo.cli.new_target_file import require_new_target_file
from rcmservo.cli.progress.compilation import report_compilation
from rcmservo.cli.progress.run_progress import LiveProgress
from rcmservo.cli.result_output import print_result
from rcmservo.cli.run_options import RunToTargetOptions
from rcmservo.cli.terminal import open_console, open_status_line
from rcmservo.config.new_folder import open_new_folder
from rcmservo.errors import require, require_extra
from rcmservo.hardware.device_kinds import prepare_tracker
from rcmservo.hardware.lab_rig import LabRig
from rcmservo.live.supervisor import run_live
from rcmservo.loop.run_result import RunResult, finite_or_none
from rcmservo.recording.reader import RECORD
from rcmservo.rig.result import read_record_if_any, save_result


@dataclass(frozen=True, kw_only=True)
class LiveOptions(RunToTargetOptions):
    """Servo in wall time at 100 Hz.

    The arm, its camera and the servo run in separate processes, and a supervisor watches the servo.
    The lab is simulated unless the rig file has an arm. Then the operator at the terminal confirms
    each step, and nothing moves before.
    """


def live(options: LiveOptions) -> int:
    """Run, write the folder and print the result; return 0 if the run settled."""
    console = open_console(stderr=options.json)
    if options.has_devices():
        require_new_target_file(options.target, options.save_target)
        rig = LabRig(options.rig, options.lab, options.digest)
        _ = options.servo  # raises an error for invalid settings before anything is written
        with open_new_folder(options.out, "live-hardware") as folder:
            result = live_on_hardware(options, rig, folder, console)
        return print_result(console, result, options.json)
    for name, path in (("--target", options.target), ("--save-target", options.save_target)):
        expected = "left out without [arm] in the rig file: a simulated run teaches its own target"
        require(path is None, name, path, expected)
    prepare_tracker(options.lab)
    with (
        require_extra("live", "sim"),
        open_new_folder(options.out, f"live-seed{options.seed}") as folder,
    ):
        words = f"simulated arm and camera, seed {options.seed}; preparing …"
        console.print(words, style="dim", soft_wrap=True)
        result = _run_simulated(options, folder, console)
    return print_result(console, result, options.json)


def _run_simulated(options: LiveOptions, folder: Path, console: Console) -> RunResult:
    """Run on the simulated arm and camera, and save the result."""
    from rcmservo.cli.run_description import describe_simulated_run
    from rcmservo.sim.processes.lab_processes import SimulatedLab

    settings, servo, duration = options.rig_settings, options.servo, options.duration
    with open_status_line(console) as status_line, SimulatedLab(options.seed, settings) as lab:
        with report_compilation(status_line):  # the servo process then finds compiled kernels
            servo.warm_up()
        record, description = folder / RECORD, describe_simulated_run(options, duration)
        tracker, frames = prepare_tracker(options.lab), options.teaching_frames
        session = lab.session(servo, tracker, duration, record, description, frames)
        result = run_live(session, lab.switch_off, LiveProgress(status_line, duration))
        error_mm = finite_or_none(lab.true_error())
    result = replace(result, seed=options.seed, estimator=options.estimator, pose_error_mm=error_mm)
    return save_result(result, read_record_if_any(folder), folder)
