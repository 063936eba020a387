"""`rcmservo live --rig lab.toml` where the file names an arm: the same servo with a laboratory's
devices, and a person at the terminal who is asked at each step.

Until `rig check` has passed for the very bytes of the file, the arm goes at a tenth of its speed.
"""

from collections.abc import Callable
from contextlib import suppress
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
from rcmservo.cli.lab.live_progress import LiveProgress
from rcmservo.cli.lab_options import LabOptions, RunToTargetOptions
from rcmservo.cli.progress.preparing import compiling
from rcmservo.cli.result_output import read_record_if_any, save_result
from rcmservo.cli.simulated_run.about import about_any
from rcmservo.cli.terminal import status_line
from rcmservo.config.rig_file import Lab, told_with
from rcmservo.config.verified_rigs import is_checked
from rcmservo.errors import UnusableFile, require
from rcmservo.hardware.cameras.settings import require_latency
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.devices import ARM_KINDS, CAMERA_KINDS, open_arm, open_camera
from rcmservo.live.device_protocols import LabArm, LabCamera
from rcmservo.live.reduced_speed import UNCHECKED_SPEED_SCALE, reduce_speed
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import run_live
from rcmservo.live.terminal_operator import Terminal
from rcmservo.loop.run_result import RunResult
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD
from rcmservo.recording.ros2_bag import METADATA
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers


def live_on_hardware(
    options: RunToTargetOptions,
    folder: Path,
    out: Console,
    arm: Callable[[Lab], LabArm] = open_arm,
    camera: Callable[[Lab], LabCamera] = open_camera,
) -> RunResult:
    """Run with the operator's leave, and keep the result."""
    Terminal().close()  # where there is none, that is told before anything is connected
    share, lab = allowed_speed_scale(options), options.lab
    servo = options.servo if share == 1.0 else reduce_speed(options.servo, share)
    out.print(f"the arm and camera of {options.rig}; preparing …", style="dim", soft_wrap=True)
    with status_line(out) as line, compiling(line):
        servo.warm_up()
    line = status_line(out)
    words, frames = motion_announcement(options, servo, share), options.teaching_frames
    preparing = HardwarePreparation(lab, words, options.target, options.save_target, frames)
    described = hardware_description(options, options.duration, share)
    session = Session(
        servo,
        options.duration,
        arm=partial(arm, lab),
        camera=partial(camera, lab),
        tracker=partial(ColourMarkers, lab.markers),
        recorder=partial(Recorder, folder / RECORD, described),
        target=partial(obtain_target, preparing),
        consent=partial(confirm_enable, preparing),
    )
    try:
        result = run_live(session, progress=LiveProgress(line, options.duration))
    except BaseException:
        _remove_empty_record(folder)
        raise
    finally:
        line.stop()
    result = replace(
        result,
        simulated=False,
        estimator=options.estimator,
        rig=str(options.rig),
        rig_sha256=options.digest,
        rig_checked=share == 1.0,
        speed_share=share,
    )
    return save_result(result, read_record_if_any(folder), folder)


def allowed_speed_scale(options: LabOptions) -> float:
    """Return the fraction of the full speed that the rig file allows."""
    return 1.0 if is_checked(options.digest) else UNCHECKED_SPEED_SCALE


def require_devices(lab: Lab, rig: Path | None, digest: str) -> None:
    """Refuse a rig file whose devices are not described, or that sends speeds to an arm that nobody
    has seen stop by itself, before anything is connected.
    """
    with told_with(rig):
        arm = lab.device("arm", ARM_KINDS)
        seen = not (isinstance(arm, CrtkSettings) and arm.jv) or is_checked(digest)
        right = "false until `rig check` has passed for this file, and seen the arm stop by itself"
        require(seen, "arm.jv", True, right)
        require_latency(lab.device("camera", CAMERA_KINDS))


def motion_announcement(options: RunToTargetOptions, servo: Servo, speed_scale: float) -> str:
    """What is going to happen once the drive is on, in words."""
    return (
        f"Once the drive is on the servo moves it for at most {options.duration:g} s: first a "
        f"little about its start, so that marker 1 goes at most {servo.exploration.reach:g} mm "
        f"from corner to corner, and then to the target. {describe_speed_limits(options, servo, speed_scale)} Ctrl-C "
        "brings it to rest; have the emergency stop at hand."
    )


def describe_speed_limits(options: LabOptions, servo: Servo, speed_scale: float) -> str:
    """How fast and how far joints go, in words."""
    x, y, z = servo.gate.speed
    lower, upper = servo.mechanism.limits.arrays
    why = (
        f"which is {100.0 * speed_scale:g} % of the full speed, as `rcmservo rig check` has not passed "
        f"for {options.rig} as it is now"
        if speed_scale < 1.0
        else f"the full speed, as `rcmservo rig check` has passed for {options.rig}"
    )
    return (
        f"No joint goes faster than {x:g} rad/s, {y:g} rad/s and {z:g} mm/s, {why}. None leaves "
        f"its limits: {format_joints(lower, options.lab)} to {format_joints(upper, options.lab)}."
    )


def hardware_description(
    options: LabOptions, duration: float, speed_scale: float
) -> dict[str, Any]:
    """Return the description of a run on hardware in its record."""
    return {
        "simulation": False,
        "rig_file": str(options.rig),
        "rig_sha256": options.digest,
        "rig_checked": speed_scale == 1.0,
        "speed_share": speed_scale,
        "devices": dict(options.lab.devices),
        **about_any(options, duration),
    }


def _remove_empty_record(folder: Path) -> None:
    """Remove the record of a run that did not begin."""
    with suppress(UnusableFile):
        if not reader.has_ticks(folder):
            reader.record_file(folder).unlink()
            (folder / METADATA).unlink(missing_ok=True)
