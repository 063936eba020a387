"""`rcmservo rig check`: whether arm, camera and rig file agree, with a person at the terminal."""

import json
import time
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

from rcmservo.app.lab.at_the_arm import AT_HAND, define
from rcmservo.app.terminal import console
from rcmservo.bringup.check import CheckReport, check, warm_up
from rcmservo.bringup.motion import Mover
from rcmservo.bringup.timing import Rhythm
from rcmservo.bringup.wiring import Robot
from rcmservo.config.checked import digest_of, forget_checked, note_checked
from rcmservo.config.rig_file import Lab, bytes_of, lab_of, told_with
from rcmservo.hardware.devices import ARMS, CAMERAS, open_arm, open_camera, wiring_of
from rcmservo.live.lab import LabArm, LabCamera
from rcmservo.live.realtime import realtime
from rcmservo.live.terminal_person import Terminal
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import WallClock
from rcmservo.tracking import ColourMarkers


@dataclass(frozen=True)
class RigOptions:
    """Connect to the arm and the camera of a rig file, move each joint a little after asking, and
    tell which lines of the file are wrong. Exit code 0: none; 1: some, or it was ended; 2: bad
    input."""

    what: Annotated[Literal["check"], tyro.conf.Positional]
    """What to do: check."""
    file: Annotated[Path, tyro.conf.Positional]
    """The rig file, such as lab.toml."""
    json: bool = False
    """Print one JSON object: ok, findings[{what, where, found, expected, line}]."""


class AtHand:
    """A person at a terminal, whose answers count only where they were typed just now."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def tell(self, words: str) -> None:
        """Say something that needs no answer."""
        self._terminal.tell(words)

    def ask(self, question: str) -> str:
        """What the person answers to this question."""
        while True:
            answer = self._terminal.ask(question)
            if time.monotonic_ns() - self._terminal.typed <= AT_HAND:
                return answer
            self.tell("That was typed a while ago; once more.")


def rig_check(
    options: RigOptions,
    arm: Callable[[Lab], LabArm] = open_arm,
    camera: Callable[[Lab], LabCamera] = lambda lab: open_camera(lab, unmeasured=True),
) -> int:
    """Check, tell what was found, and note the file that passed by its bytes; the exit code."""
    data = bytes_of(options.file)
    lab, digest = lab_of(options.file, data), digest_of(data)
    with told_with(options.file):
        lab.device("arm", ARMS)
        latency = float(lab.device("camera", CAMERAS).latency)
        robot = Robot(lab.mechanism, lab.tool, wiring_of(lab))
    with closing(Terminal()) as person:
        person.tell(f"rig check of {options.file}: connecting, with the drive off")
        warm_up(robot, lab.gate)
        clock, tracker, silence = WallClock(), ColourMarkers(lab.markers), lab.thresholds.silence
        with (
            closing(arm(lab)) as joints,
            closing(camera(lab)) as eye,
            TrackingThread(eye, tracker, clock) as seen,
        ):
            told = partial(trouble, eye)
            mover = Mover(joints, seen, seen, clock, robot, lab.gate, silence, told)
            if not joints.homed():
                define(person, mover.plant, lab)
            try:
                with realtime():
                    report = check(mover, AtHand(person), robot, lab.thresholds, latency)
            except BaseException:
                forget_checked(digest)
                raise
    (note_checked if report.ok else forget_checked)(digest)
    if options.json:
        print(json.dumps({"ok": report.ok, "findings": [asdict(one) for one in report.findings]}))
    else:
        show(report, robot, console(False))
    return 0 if report.ok else 1


def trouble(camera: LabCamera) -> str:
    """What is wrong with a camera now, in a sentence; empty where nothing is."""
    return camera.account().trouble


def show(report: CheckReport, robot: Robot, out: Console) -> None:
    """The report as tables."""
    seen = Table(title="rig check", show_header=False)
    for name, words in measured(report, robot):
        seen.add_row(name, words)
    out.print(seen)
    if report.ok:
        out.print("all is as the rig file says; live may use the full speed with it")
        return
    wrong = Table(title="what is wrong")
    for name in ("what", "where", "found", "expected", "line of the rig file"):
        wrong.add_column(name, overflow="fold")
    for one in report.findings:
        wrong.add_row(one.what, one.where, one.found, one.expected, one.line)
    out.print(wrong)


def measured(report: CheckReport, robot: Robot) -> list[tuple[str, str]]:
    """What was measured, in words."""
    rows: list[tuple[str, str]] = []
    if report.q is not None:
        q = [f"{np.degrees(report.q[0]):.2f} deg", f"{np.degrees(report.q[1]):.2f} deg"]
        told = zip(robot.mechanism.joint_names, [*q, f"{report.q[2]:.2f} mm"], strict=True)
        rows.append(("joints", ", ".join(f"{name} {value}" for name, value in told)))
    for name, pace in (("arm's answers", report.arm), ("frames", report.camera)):
        if pace is not None:
            rows.append((name, _pace(pace)))
    if report.rest is not None:
        rest = report.rest
        found = 100.0 * rest.frames / (rest.frames + rest.missed)
        rows.append(("markers", f"{found:.0f} % found, noise {rest.noise:.3f} px at rest"))
    late = report.lateness
    if late is not None:
        words = f"{1e3 * late.latency:.1f} ms, to {1e3 * late.within:.1f} ms"
        rows.append(("latency", f"{words}; jitter {1e3 * late.jitter:.1f} ms"))
    if report.lag > 0.0:
        rows.append(("drives lag", f"{1e3 * report.lag:.0f} ms"))
    if report.undecided:
        rows.append(("told apart by asking only", "\n".join(report.undecided)))
    return rows


def _pace(pace: Rhythm) -> str:
    return f"{pace.rate:.1f} per s, jitter {1e3 * pace.jitter:.1f} ms"
