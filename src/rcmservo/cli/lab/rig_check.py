"""`rcmservo rig check`: check with the operator whether arm, camera and rig file agree."""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.backlash import Backlash
from rcmservo.bringup.check import CheckReport, check, warm_up
from rcmservo.bringup.findings import Finding
from rcmservo.bringup.motion import IDLE_TIMEOUT, Mover
from rcmservo.cli.lab.hardware_prompts import AttendedTerminal, define_joints
from rcmservo.cli.terminal import build_two_column_table, open_console
from rcmservo.config.rig_file import (
    RigDescription,
    decode_rig_file,
    name_origin_in_errors,
    read_rig_file,
)
from rcmservo.config.verified_rigs import compute_digest, mark_rig_verified, unmark_rig_verified
from rcmservo.hardware.device_kinds import (
    make_tracker,
    open_arm,
    open_camera,
    prepare_tracker,
    read_latency,
    read_wiring,
)
from rcmservo.live.device_protocols import LabArm, LabCamera
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.live.stop_signals import stopped_by_signals
from rcmservo.live.terminal_operator import Terminal
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock
from rcmservo.rig.rig import require_drive_off


@dataclass(frozen=True)
class RigOptions:
    """Check a rig file at the arm: move each joint a little after confirmation, and report errors.

    Exit code 0: no errors; 1: errors, or the check was stopped; 2: invalid input.

    Parameters
    ----------
    what : Literal['check']
        Action: check.
    file : Path
        Rig file, such as lab.toml.
    json : bool
        Print one JSON object: ok, findings[{what, where, found, expected, line}].
    """

    what: Annotated[Literal["check"], tyro.conf.Positional]
    file: Annotated[Path, tyro.conf.Positional]
    json: bool = False


def rig_check(
    options: RigOptions,
    arm: Callable[[RigDescription], LabArm] = open_arm,
    camera: Callable[[RigDescription], LabCamera] = lambda lab: open_camera(
        lab, accepts_unmeasured_latency=True
    ),
) -> int:
    """Check a rig file, report the findings, and store its digest if it passes.

    Parameters
    ----------
    options : RigOptions
        Options of the command.
    arm : Callable
        Function that connects to the arm of a lab.
    camera : Callable
        Function that opens the camera of a lab, whose latency may be unmeasured.

    Returns
    -------
    int
        Exit code.
    """
    data = read_rig_file(options.file)
    lab, digest = decode_rig_file(options.file, data), compute_digest(data)
    with name_origin_in_errors(options.file):
        robot = Robot(lab.mechanism, lab.tool, read_wiring(lab))
        latency, has_latency_key = read_latency(lab)
    prepare_tracker(lab)
    with stopped_by_signals(), closing(Terminal()) as terminal:
        operator = AttendedTerminal(terminal)
        operator.notify(
            f"rig check of {options.file}: connecting, with the drive off; on first use, the "
            "marker detection is compiled, which takes up to a minute"
        )
        warm_up(robot, lab.gate)
        clock, tracker = WallClock(), make_tracker(lab)
        arm_timeout_s = lab.thresholds.arm_timeout
        with (
            closing(camera(lab)) as device,
            TrackingThread(device, tracker, clock) as tracking,
            closing(_connect_arm(tracking, arm, lab)) as joints,
        ):
            fault = partial(find_camera_fault, device)
            mover = Mover(joints, tracking, tracking, clock, robot, lab.gate, arm_timeout_s, fault)
            require_drive_off(mover.plant)
            if not joints.is_homed():
                define_joints(operator, mover.plant, lab)
            unmark_rig_verified(digest)
            with apply_realtime_settings():
                report = check(mover, operator, robot, lab.thresholds, latency, has_latency_key)
    if joints.off_reason:
        expected = "drive disabled by the check at its end"
        finding = Finding("the drive went off by itself", "arm", joints.off_reason, expected)
        report.findings.append(finding)
    return report_result(options, report, robot, digest)


def _connect_arm(
    tracking: TrackingThread, arm: Callable[[RigDescription], LabArm], lab: RigDescription
) -> LabArm:
    """Connect to the arm once two frames are tracked.

    The tracker searches the first frame and follows the markers in the second, so both parts are
    then compiled.
    """
    tracking.wait_for(frames=2, timeout_s=IDLE_TIMEOUT)
    return arm(lab)


def report_result(options: RigOptions, report: CheckReport, robot: Robot, digest: str) -> int:
    """Print the report, store the digest of a file that passed, and return the exit code."""
    if options.json:
        print(
            json.dumps(
                {"ok": report.ok, "findings": [asdict(finding) for finding in report.findings]}
            )
        )
    else:
        print_report(report, robot, open_console())
    if report.ok:
        mark_rig_verified(digest)
    return 0 if report.ok else 1


def find_camera_fault(camera: LabCamera) -> str:
    """Return the present fault of a camera in a sentence; empty if it has none."""
    return camera.counts().trouble


def print_report(report: CheckReport, robot: Robot, console: Console) -> None:
    """Print the report as tables."""
    console.print(build_two_column_table("rig check", list_measurements(report, robot)))
    if report.ok:
        console.print("arm and camera agree with the rig file; live may use the full speed with it")
        return
    errors = Table(title="errors")
    for name in ("what", "where", "found", "expected", "line of the rig file"):
        errors.add_column(name, overflow="fold")
    for finding in report.findings:
        errors.add_row(finding.what, finding.where, finding.found, finding.expected, finding.line)
    console.print(errors)


def describe_backlash(backlash: Backlash, robot: Robot) -> tuple[str, str]:
    """Return the name and the size of a backlash, and how well a pose is repeated."""
    joint = backlash.joint
    unit, scale = (" mm", 1.0) if joint == 2 else (" deg", np.degrees(1.0))
    sizes = scale * np.array([backlash.size, 2.0 * backlash.deviation, backlash.repeatability])
    size = f"{sizes[0]:.3f}{unit} ± {sizes[1]:.3f}" if backlash.is_measured else "none"
    return (
        f"backlash of {robot.describe_joint(joint)}",
        f"{size}, a pose is repeated within {max(sizes[2], sizes[1]):.3f}{unit}",
    )


def format_simulation_lines(report: CheckReport) -> str:
    """Return the sections of a rig file that simulate the measured backlash and lag."""
    sizes = [one.size if one.is_measured else 0.0 for one in report.backlash]
    backlash = ", ".join(f"{size:.2g}" for size in sizes)
    lag = f"\n[drive]\nlag = {report.lag:.3f}" if report.lag > 0.0 else ""
    return f"[imperfections]\nbacklash = [{backlash}]{lag}"


def list_measurements(report: CheckReport, robot: Robot) -> list[tuple[str, str]]:
    """Return the names and values of all measurements, in words."""
    rows: list[tuple[str, str]] = []
    if report.q is not None:
        q = [f"{np.degrees(report.q[0]):.2f} deg", f"{np.degrees(report.q[1]):.2f} deg"]
        joints = zip(robot.mechanism.joint_names, [*q, f"{report.q[2]:.2f} mm"], strict=True)
        rows.append(("joints", ", ".join(f"{name} {value}" for name, value in joints)))
    for name, cadence in (("arm's answers", report.arm), ("frames", report.camera)):
        if cadence is not None:
            rate = f"{cadence.rate:.1f} per s, jitter {1e3 * cadence.jitter:.1f} ms"
            rows.append((name, rate))
    if report.rest is not None:
        rest = report.rest
        detected = 100.0 * rest.frames / (rest.frames + rest.missed)
        rows.append(("markers", f"{detected:.0f} % detected, noise {rest.noise:.3f} px at rest"))
    latency = report.latency
    if latency is not None:
        value = f"{1e3 * latency.latency:.1f} ms, uncertainty {1e3 * latency.deviation:.1f} ms"
        rows.append(("latency", f"{value}; jitter {1e3 * latency.jitter:.1f} ms"))
    if report.lag > 0.0:
        rows.append(("drive lag", f"{1e3 * report.lag:.0f} ms"))
    rows += [describe_backlash(backlash, robot) for backlash in report.backlash]
    if report.backlash:
        rows.append(("lines for a simulation of this arm", format_simulation_lines(report)))
    if report.undecided:
        rows.append(("not distinguished by the image", "\n".join(report.undecided)))
    if report.unclear:
        rows.append(("not verifiable by the check", "\n".join(report.unclear)))
    return rows
