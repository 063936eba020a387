"""`rcmservo live --rig lab.toml` where the file names an arm: the same servo with a laboratory's
devices, and a person at the terminal who is asked at each step.

Until `rig check` has passed for the very bytes of the file, the arm goes at a tenth of its speed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from rcmservo.app.lab.at_the_arm import Preparing, leave_to_move, target_at_the_arm, words_of
from rcmservo.app.lab.live_told import (
    LoopMetrics,
    Progress,
    add_loop,
    drop_empty,
    kept,
    loop_metrics,
)
from rcmservo.app.lab_options import LabOptions, RunToTargetOptions
from rcmservo.app.simulated_run.about import about_any
from rcmservo.app.simulated_run.metrics import FeatureError, number
from rcmservo.app.terminal import live_line, result_table, unit
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
from rcmservo.record.reader import RECORD
from rcmservo.record.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.tracking import ColourMarkers


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
    options: RunToTargetOptions,
    folder: Path,
    out: Console,
    arm: Callable[[Lab], LabArm] = open_arm,
    camera: Callable[[Lab], LabCamera] = open_camera,
) -> HardwareMetrics:
    """Run with a person's leave, and keep what came of it."""
    Terminal().close()  # where there is none, that is told before anything is connected
    share, lab = speed_share(options), options.lab
    servo = options.servo if share == 1.0 else cautious(options.servo, share)
    out.print(f"the arm and camera of {options.rig}; preparing …", style="dim", soft_wrap=True)
    with live_line(out) as line, compiling(line):
        servo.warm_up()
    line = live_line(out)
    words, frames = intent(options, servo, share), options.teaching_frames
    preparing = Preparing(lab, words, options.target, options.save_target, frames)
    described = about(options, options.duration, share)
    session = Session(
        servo,
        options.duration,
        arm=partial(arm, lab),
        camera=partial(camera, lab),
        tracker=partial(ColourMarkers, lab.markers),
        recorder=partial(Recorder, folder / RECORD, described),
        target=partial(target_at_the_arm, preparing),
        consent=partial(leave_to_move, preparing),
    )
    try:
        result = run_live(session, progress=Progress(line, options.duration))
    except BaseException:
        drop_empty(folder)
        raise
    finally:
        line.stop()
    return kept(folder, metrics_of(options, folder, share, result))


def speed_share(options: LabOptions) -> float:
    """Return the fraction of the full speed that the rig file allows."""
    return 1.0 if is_checked(options.digest) else SHARE


def require_devices(lab: Lab, rig: Path | None, digest: str) -> None:
    """Refuse a rig file whose devices are not described, or that sends speeds to an arm that nobody
    has seen stop by itself, before anything is connected."""
    with told_with(rig):
        arm = lab.device("arm", ARMS)
        seen = not (isinstance(arm, CrtkSettings) and arm.jv) or is_checked(digest)
        right = "false until `rig check` has passed for this file, and seen the arm stop by itself"
        require(seen, "arm.jv", True, right)
        require_latency(lab.device("camera", CAMERAS))


def intent(options: RunToTargetOptions, servo: Servo, share: float) -> str:
    """What is going to happen once the drive is on, in words."""
    return (
        f"Once the drive is on the servo moves it for at most {options.duration:g} s: first a "
        f"little about its start, so that marker 1 goes at most {servo.exploration.reach:g} mm "
        f"from corner to corner, and then to the target. {bounds(options, servo, share)} Ctrl-C "
        "brings it to rest; have the emergency stop at hand."
    )


def bounds(options: LabOptions, servo: Servo, share: float) -> str:
    """How fast and how far joints go, in words."""
    x, y, z = servo.gate.speed
    lower, upper = servo.mechanism.limits.arrays
    why = (
        f"which is {100.0 * share:g} % of the full speed, as `rcmservo rig check` has not passed "
        f"for {options.rig} as it is now"
        if share < 1.0
        else f"the full speed, as `rcmservo rig check` has passed for {options.rig}"
    )
    return (
        f"No joint goes faster than {x:g} rad/s, {y:g} rad/s and {z:g} mm/s, {why}. None leaves "
        f"its limits: {words_of(lower, options.lab)} to {words_of(upper, options.lab)}."
    )


def about(options: LabOptions, duration: float, share: float) -> dict[str, Any]:
    """Return the description of a run on hardware in its record."""
    return {
        "simulation": False,
        "rig_file": str(options.rig),
        "rig_sha256": options.digest,
        "rig_checked": share == 1.0,
        "speed_share": share,
        "devices": dict(options.lab.devices),
        **about_any(options, duration),
    }


def metrics_of(
    options: LabOptions, folder: Path, share: float, result: LiveResult
) -> HardwareMetrics:
    """What the supervisor says of a run."""
    outcome, target, timing = result.outcome, result.target, result.timing
    settled = outcome.settled and not result.why_off
    return HardwareMetrics(
        simulated=False,
        estimator=options.estimator,
        rig=str(options.rig),
        rig_sha256=options.digest,
        rig_checked=share == 1.0,
        speed_share=share,
        folder=str(folder),
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
