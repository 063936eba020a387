"""`rcmservo live --rig lab.toml` for a file with an arm: the servo on the devices of a lab.

The operator at the terminal confirms each step. Until `rig check` has passed for the exact bytes of
the file, the arm moves at a tenth of its speed.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from rcmservo.cli.lab.hardware_prompts import (
    HardwarePreparation,
    confirm_enable,
    format_joints,
    obtain_target,
)
from rcmservo.cli.progress.compilation import report_compilation
from rcmservo.cli.progress.run_progress import LiveProgress
from rcmservo.cli.run_description import describe_run
from rcmservo.cli.run_options import LabOptions, RunToTargetOptions
from rcmservo.cli.terminal import open_status_line
from rcmservo.config.rig_file import RigDescription
from rcmservo.config.verified_rigs import is_rig_verified
from rcmservo.hardware.device_kinds import (
    open_arm,
    open_camera,
    prepare_tracker,
)
from rcmservo.live.device_protocols import LabArm, LabCamera
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import run_live
from rcmservo.live.terminal_operator import Terminal
from rcmservo.live.unchecked_rig_speed import UNCHECKED_SPEED_SCALE, reduce_speed
from rcmservo.loop.run_result import RunResult
from rcmservo.recording.reader import RECORD
from rcmservo.recording.writer import Recorder
from rcmservo.rig.confirmation import announce_motion
from rcmservo.rig.result import read_record_if_any, remove_empty_record, save_result
from rcmservo.servo.servo import Servo


def live_on_hardware(
    options: RunToTargetOptions,
    folder: Path,
    console: Console,
    arm: Callable[[RigDescription], LabArm] = open_arm,
    camera: Callable[[RigDescription], LabCamera] = open_camera,
) -> RunResult:
    """Run on the devices of a lab after the operator's confirmation, and save the result.

    Parameters
    ----------
    options : RunToTargetOptions
        Options of the command.
    folder : Path
        Output folder.
    console : Console
        Console for the progress.
    arm : Callable
        Function that connects to the arm of a lab.
    camera : Callable
        Function that opens the camera of a lab.
    """
    Terminal().close()  # a missing terminal is reported before anything is connected
    speed_scale, lab = find_allowed_speed_scale(options), options.lab
    servo = options.servo if speed_scale == 1.0 else reduce_speed(options.servo, speed_scale)
    console.print(f"the arm and camera of {options.rig}; preparing …", style="dim", soft_wrap=True)
    with open_status_line(console) as line, report_compilation(line):
        servo.warm_up()
    line = open_status_line(console)
    announcement, frames = describe_motion(options, servo, speed_scale), options.teaching_frames
    preparation = HardwarePreparation(
        lab, announcement, options.target, options.save_target, frames
    )
    description = describe_hardware_run(options, options.duration, speed_scale)
    session = Session(
        servo,
        options.duration,
        arm=partial(arm, lab),
        camera=partial(camera, lab),
        tracker=prepare_tracker(lab),
        recorder=partial(Recorder, folder / RECORD, description),
        target=partial(obtain_target, preparation),
        consent=partial(confirm_enable, preparation),
    )
    try:
        result = run_live(session, progress=LiveProgress(line, options.duration))
    except BaseException:
        remove_empty_record(folder)
        raise
    finally:
        line.stop()
    result = replace(
        result,
        simulated=False,
        estimator=options.estimator,
        rig=str(options.rig),
        rig_sha256=options.digest,
        rig_checked=speed_scale == 1.0,
        speed_scale=speed_scale,
    )
    return save_result(result, read_record_if_any(folder), folder)


def find_allowed_speed_scale(options: LabOptions) -> float:
    """Return the fraction of the full speed that is allowed with the rig file."""
    return 1.0 if is_rig_verified(options.digest) else UNCHECKED_SPEED_SCALE


def describe_motion(options: RunToTargetOptions, servo: Servo, speed_scale: float) -> str:
    """Return the announcement of the motion that follows once the drive is on."""
    limits = describe_speed_limits(options, servo, speed_scale)
    return announce_motion(servo, options.duration, limits)


def describe_speed_limits(options: LabOptions, servo: Servo, speed_scale: float) -> str:
    """Return the limits of the joints' speeds and positions in words."""
    speed_1, speed_2, speed_3 = servo.gate.speed
    lower, upper = servo.mechanism.limits.arrays
    reason = (
        f"which is {100.0 * speed_scale:g} % of the full speed, because `rcmservo rig check` has "
        f"not passed for the present {options.rig}"
        if speed_scale < 1.0
        else f"the full speed, because `rcmservo rig check` has passed for {options.rig}"
    )
    return (
        f"The joints move at most at {speed_1:g} rad/s, {speed_2:g} rad/s and {speed_3:g} mm/s, "
        f"{reason}. They stay "
        f"between {format_joints(lower, options.lab)} and {format_joints(upper, options.lab)}."
    )


def describe_hardware_run(
    options: LabOptions, duration: float, speed_scale: float
) -> dict[str, Any]:
    """Return the description of a run on hardware in its record."""
    return {
        "simulation": False,
        "rig_file": str(options.rig),
        "rig_sha256": options.digest,
        "rig_checked": speed_scale == 1.0,
        "speed_scale": speed_scale,
        "devices": dict(options.lab.devices),
        **describe_run(options, duration),
    }
