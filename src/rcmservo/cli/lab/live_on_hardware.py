"""`rcmservo live --rig lab.toml` for a file with an arm: the servo on the devices of a lab.

The operator at the terminal confirms each step. Until `rig check` has passed for the exact bytes of
the file, the arm moves at a tenth of its speed.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

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
from rcmservo.cli.run_options import RunToTargetOptions
from rcmservo.cli.terminal import open_status_line
from rcmservo.hardware.lab_rig import LabRig
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import run_live
from rcmservo.live.terminal_operator import Terminal
from rcmservo.loop.run_result import RunResult
from rcmservo.recording.reader import RECORD
from rcmservo.recording.writer import Recorder
from rcmservo.rig.confirmation import announce_motion
from rcmservo.rig.result import read_record_if_any, remove_empty_record, save_result
from rcmservo.servo.servo import Servo


def live_on_hardware(
    options: RunToTargetOptions, rig: LabRig, folder: Path, console: Console
) -> RunResult:
    """Run on the devices of a lab after the operator's confirmation, and save the result.

    Parameters
    ----------
    options : RunToTargetOptions
        Options of the command.
    rig : LabRig
        Arm and camera of the lab, not connected.
    folder : Path
        Output folder.
    console : Console
        Console for the progress.
    """
    Terminal().close()  # a missing terminal is reported before anything is connected
    servo = rig.adapt(options.servo)
    console.print(f"the arm and camera of {rig.path}; preparing …", style="dim", soft_wrap=True)
    with open_status_line(console) as line, report_compilation(line):
        servo.warm_up()
    line = open_status_line(console)
    preparation = HardwarePreparation(
        rig.description,
        announce_motion(servo, options.duration, describe_speed_limits(rig, servo)),
        options.target,
        options.save_target,
        options.teaching_frames,
    )
    description = rig.describe() | describe_run(options, options.duration)
    session = Session(
        servo,
        options.duration,
        rig,
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
        rig=str(rig.path),
        rig_sha256=rig.digest,
        rig_checked=rig.speed_scale == 1.0,
        speed_scale=rig.speed_scale,
    )
    return save_result(result, read_record_if_any(folder), folder)


def describe_speed_limits(rig: LabRig, servo: Servo) -> str:
    """Return the limits of the joints' speeds and positions in words."""
    speed_1, speed_2, speed_3 = servo.gate.speed
    lower, upper = servo.mechanism.limits.arrays
    reason = (
        f"which is {100.0 * rig.speed_scale:g} % of the full speed, because `rcmservo rig check` "
        f"has not passed for the present {rig.path}"
        if rig.speed_scale < 1.0
        else f"the full speed, because `rcmservo rig check` has passed for {rig.path}"
    )
    return (
        f"The joints move at most at {speed_1:g} rad/s, {speed_2:g} rad/s and {speed_3:g} mm/s, "
        f"{reason}. They stay between {format_joints(lower, rig.description)} and "
        f"{format_joints(upper, rig.description)}."
    )
