"""`rcmservo live --rig lab.toml` where the file names an arm: the same servo with a laboratory's
devices, and a person at the terminal who is asked at each step.

Until `rig check` has passed for the very bytes of the file, the arm goes at a tenth of its speed.
"""

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from rcmservo.app.lab.at_the_arm import Preparing, leave_to_move, target_at_the_arm, words_of
from rcmservo.app.lab.live_told import (
    LoopMetrics,
    Progress,
    add_loop,
    drop_empty,
    kept,
    loop_metrics,
)
from rcmservo.app.simulated_run.metrics import FeatureError, number
from rcmservo.app.terminal import result_table, unit
from rcmservo.app.waiting.preparing import compiling
from rcmservo.config.checked import is_checked
from rcmservo.config.rig_file import Lab, told_with
from rcmservo.errors import require
from rcmservo.hardware.cameras.settings import require_latency
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.hardware.devices import ARMS, CAMERAS, open_arm, open_camera
from rcmservo.live.cautious import SHARE, cautious
from rcmservo.live.lab import CameraAccount, LabArm, LabCamera
from rcmservo.live.reports import LiveResult
from rcmservo.live.servo_process import Session
from rcmservo.live.supervisor import run_live
from rcmservo.live.terminal_person import Terminal
from rcmservo.loop.shown import TEACHING_FRAMES
from rcmservo.record.reader import RECORD
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


@dataclass(frozen=True)
class CameraMetrics:
    """What became of the camera's frames."""

    frames: int
    """Those that were delivered."""
    lost: int
    """Those that the camera took and that never came."""
    incomplete: int
    """Those that came damaged and were dropped."""
    reconnects: int
    """How often the camera was opened again."""
    uncertainty_ms: float | None
    """How well exposure times are known on the computer's clock; None of a camera that tells
    none."""
    trouble: str
    """What was wrong with it at the end; empty where nothing was."""


@dataclass(frozen=True)
class HardwareMetrics:
    """A run on hardware in numbers: what metrics.json holds, by the same names. There is no truth
    to tell a pose error by."""

    simulated: bool
    """False."""
    estimator: str
    """The estimator's name on the command line."""
    rig: str
    """The rig file."""
    rig_sha256: str
    """Of its bytes."""
    rig_checked: bool
    """Whether `rig check` had passed for them."""
    speed_share: float
    """Share of the full speed that was allowed."""
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
    drive_off: str
    """Why the arm's drive went off by itself, or is not known to be off; empty where it went off in
    the end as it should."""
    camera: CameraMetrics | None
    """None where the servo's process came to no end."""
    not_recorded: str
    """Why the record ends early; empty where it does not."""
    target_q: list[float] | None
    """The joints at which the target was shown."""
    loop: LoopMetrics | None
    """None where the servo's process came to no end."""
    not_written: str = ""
    """Which of the metrics and figures could not be written, and why."""


def live_on_hardware(
    job: HardwareJob,
    out: Console,
    arm: Callable[[Lab], LabArm] = open_arm,
    camera: Callable[[Lab], LabCamera] = open_camera,
) -> HardwareMetrics:
    """Run with a person's leave, and keep what came of it."""
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
        result = run_live(session, progress=Progress(line, job.duration))
    except BaseException:
        drop_empty(job.folder)
        raise
    finally:
        line.stop()
    return kept(job.folder, metrics_of(job, share, result))


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


def metrics_of(job: HardwareJob, share: float, result: LiveResult) -> HardwareMetrics:
    """What the supervisor says of a run."""
    outcome, target, timing = result.outcome, result.target, result.timing
    settled = outcome.settled and not result.why_off
    return HardwareMetrics(
        simulated=False,
        estimator=job.estimator,
        rig=str(job.rig),
        rig_sha256=job.digest,
        rig_checked=share == 1.0,
        speed_share=share,
        folder=str(job.folder),
        settled=settled,
        cause=outcome.cause or result.why_off,
        remark=outcome.remark,
        settle_time_s=outcome.settle_time if settled else None,
        feature_error=FeatureError(*map(number, outcome.error)),
        explored_s=outcome.explored_at,
        drive_off=result.why_off,
        camera=None if result.camera is None else _camera(result.camera),
        not_recorded=result.not_recorded,
        target_q=None if target is None else target.q.tolist(),
        loop=None if timing is None else loop_metrics(timing),
    )


def _camera(a: CameraAccount) -> CameraMetrics:
    ms = number(1e3 * a.uncertainty)
    return CameraMetrics(a.frames, a.lost, a.incomplete, a.reconnects, ms, a.trouble)


def show_hardware(out: Console, metrics: HardwareMetrics) -> None:
    """The result as a table, and where its files are."""
    table = result_table(metrics.settled, metrics.cause)
    if metrics.drive_off:
        table.add_row("arm", metrics.drive_off)
    if metrics.remark:
        table.add_row("at the end", metrics.remark)
    table.add_row("settle time", unit(metrics.settle_time_s, "s", 2))
    checked = "rig check has passed" if metrics.rig_checked else "rig check has not passed"
    table.add_row("speed", f"at most {100.0 * metrics.speed_share:g} %: {checked}")
    if metrics.camera is not None:
        table.add_row("camera", _frames(metrics.camera))
    if metrics.loop is not None:
        add_loop(table, metrics.loop)
    if metrics.not_recorded:
        table.add_row("not recorded", metrics.not_recorded)
    if metrics.not_written:
        table.add_row("not written", metrics.not_written)
    out.print(table)
    out.print(f"files in {metrics.folder}", soft_wrap=True)


def _frames(camera: CameraMetrics) -> str:
    times = camera.uncertainty_ms
    told = "exposure times unchecked"
    if times is not None:
        told = f"exposure times to {times:.2f} ms"
    counts = f"{camera.frames} frames, {camera.lost} lost, {camera.incomplete} incomplete"
    again = f"opened again {camera.reconnects} x"
    return "; ".join(filter(None, (f"{counts}, {again}", told, camera.trouble)))
