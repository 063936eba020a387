"""`rcmservo live --rig lab.toml` where the file names an arm: the same servo with a laboratory's
devices, and a person at the terminal who is asked at each step.

Until `rig check` has passed for the very bytes of the file, the arm goes at a tenth of its speed.
"""

import platform
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from rcmservo.app.lab.at_the_arm import Preparing, leave_to_move, target_at_the_arm, words_of
from rcmservo.app.lab.live_progress import LiveProgress
from rcmservo.app.result_output import record_in, save_result
from rcmservo.app.waiting.preparing import compiling
from rcmservo.config.checked import is_checked
from rcmservo.config.rig_file import Lab, told_with
from rcmservo.errors import UnusableFile, require
from rcmservo.hardware.cameras.settings import require_latency
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.devices import ARMS, CAMERAS, open_arm, open_camera
from rcmservo.live.cautious import SHARE, cautious
from rcmservo.live.lab import LabArm, LabCamera
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import run_live
from rcmservo.live.terminal_person import Terminal
from rcmservo.loop.run_result import RunResult
from rcmservo.loop.shown import TEACHING_FRAMES
from rcmservo.record import reader
from rcmservo.record.reader import RECORD
from rcmservo.record.ros2_bag import METADATA
from rcmservo.record.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers


@dataclass(frozen=True)
class HardwareJob:
    """What to move, how, and where to write."""

    servo: Servo
    """What is to reach the target, as the options have it: at full speed."""
    estimator: str
    """Its estimator's name on the command line."""
    duration: float
    """Length of the run, s."""
    lab: Lab
    """The laboratory with its devices."""
    rig: Path
    """Its file,"""
    digest: str
    """and what the bytes of that are known by."""
    folder: Path
    """Where record, metrics and figures go."""
    target: Path | None = None
    """The file that holds the target; None where it is shown by hand."""
    save_target: Path | None = None
    """A new file to keep the target in that is shown; None where it is not kept."""
    teaching_frames: int = TEACHING_FRAMES
    """Frames that a target is the mean of."""


def live_on_hardware(
    job: HardwareJob,
    out: Console,
    arm: Callable[[Lab], LabArm] = open_arm,
    camera: Callable[[Lab], LabCamera] = open_camera,
) -> RunResult:
    """Run with the operator's leave, and keep the result."""
    Terminal().close()  # where there is none, that is told before anything is connected
    share = 1.0 if is_checked(job.digest) else SHARE
    servo = job.servo if share == 1.0 else cautious(job.servo, share)
    out.print(f"the arm and camera of {job.rig}; preparing …", style="dim", soft_wrap=True)
    with Live(Text(""), console=out, refresh_per_second=8, transient=True) as line, compiling(line):
        servo.warm_up()
    line = Live(Text(""), console=out, refresh_per_second=8, transient=True)
    words, frames = intent(job, servo, share), job.teaching_frames
    preparing = Preparing(job.lab, words, job.target, job.save_target, frames)
    session = Session(
        servo,
        job.duration,
        arm=partial(arm, job.lab),
        camera=partial(camera, job.lab),
        tracker=partial(ColourMarkers, job.lab.markers),
        recorder=partial(Recorder, job.folder / RECORD, about(job, share)),
        target=partial(target_at_the_arm, preparing),
        consent=partial(leave_to_move, preparing),
    )
    try:
        result = run_live(session, progress=LiveProgress(line, job.duration))
    except BaseException:
        _drop_empty(job.folder)
        raise
    finally:
        line.stop()
    result = replace(
        result,
        simulated=False,
        estimator=job.estimator,
        rig=str(job.rig),
        rig_sha256=job.digest,
        rig_checked=share == 1.0,
        speed_share=share,
    )
    return save_result(result, record_in(job.folder), job.folder)


def require_devices(lab: Lab, rig: Path, digest: str) -> None:
    """Refuse a rig file whose devices are not described, or that sends speeds to an arm that nobody
    has seen stop by itself, before anything is connected."""
    with told_with(rig):
        arm = lab.device("arm", ARMS)
        seen = not (isinstance(arm, CrtkSettings) and arm.jv) or is_checked(digest)
        right = "false until `rig check` has passed for this file, and seen the arm stop by itself"
        require(seen, "arm.jv", True, right)
        require_latency(lab.device("camera", CAMERAS))


def intent(job: HardwareJob, servo: Servo, share: float) -> str:
    """What is going to happen once the drive is on, in words."""
    return (
        f"Once the drive is on the servo moves it for at most {job.duration:g} s: first a little "
        f"about its start, so that marker 1 goes at most {servo.exploration.reach:g} mm from "
        f"corner to corner, and then to the target. {bounds(job, servo, share)} Ctrl-C brings "
        "it to rest; have the emergency stop at hand."
    )


def bounds(job: HardwareJob, servo: Servo, share: float) -> str:
    """How fast and how far joints go, in words."""
    x, y, z = servo.gate.speed
    lower, upper = servo.mechanism.limits.arrays
    why = (
        f"which is {100.0 * share:g} % of the full speed, as `rcmservo rig check` has not passed "
        f"for {job.rig} as it is now"
        if share < 1.0
        else f"the full speed, as `rcmservo rig check` has passed for {job.rig}"
    )
    return (
        f"No joint goes faster than {x:g} rad/s, {y:g} rad/s and {z:g} mm/s, {why}. None leaves "
        f"its limits: {words_of(lower, job.lab)} to {words_of(upper, job.lab)}."
    )


def about(job: HardwareJob, share: float) -> dict[str, Any]:
    """What a record says of its run beside its stages."""
    packages = "numpy", "numba", "opencv-python-headless"
    return {
        "simulation": False,
        "duration_s": job.duration,
        "estimator": job.estimator,
        "mechanism": job.servo.mechanism.name,
        "teaching_frames": job.teaching_frames,
        "rig_file": str(job.rig),
        "rig_sha256": job.digest,
        "rig_checked": share == 1.0,
        "speed_share": share,
        "devices": dict(job.lab.devices),
        "markers": asdict(job.lab.markers),
        "versions": {
            "rcmservo": version("rcmservo"),
            "python": platform.python_version(),
            **{name: version(name) for name in packages},
        },
    }


def _drop_empty(folder: Path) -> None:
    """Remove the record of a run that did not begin."""
    with suppress(UnusableFile):
        if not reader.begun(folder):
            reader.file_of(folder).unlink()
            (folder / METADATA).unlink(missing_ok=True)
