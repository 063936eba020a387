"""`rig check` of a user's own arm and camera: their findings, in simulated time."""

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rig_check_lab import FaultyLab, Mistake

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.check import CheckReport, check
from rcmservo.bringup.motion import Mover
from rcmservo.cli.lab import rig_check
from rcmservo.cli.lab.rig_check import RigOptions
from rcmservo.config.rig_file import load_rig_file
from rcmservo.config.verified_rigs import compute_digest, is_rig_verified
from rcmservo.hardware.device_kinds import (
    make_tracker,
    open_arm,
    open_camera,
    read_latency,
    read_wiring,
)
from rcmservo.interfaces import ArmMeasurement, Command, Floats, Frame, Markers

CLOCK_ERROR_NS = 40_000_000
"""Error of an own camera's exposure times."""

RIG = """
[arm]
kind = "simulated_devices:OwnSimulatedArm"
[camera]
kind = "simulated_devices:OwnSimulatedCamera"
[tracker]
kind = "simulated_devices:OwnPointTracker"
"""


class OwnSimulatedArm:
    """Arm of a simulated laboratory, with the methods of the protocol only."""

    lab: FaultyLab

    def enable(self) -> None:
        self.lab.arm.enable()

    def measure(self) -> ArmMeasurement:
        return self.lab.arm.measure()

    def apply(self, command: Command) -> Floats:
        return self.lab.arm.apply(command)


class OwnRateControlledArm(OwnSimulatedArm):
    """Own arm whose watchdog the check can test."""

    off_reason, is_rate_controlled = "", True

    def is_homed(self) -> bool:
        return True

    def set_position(self, q: Floats) -> None:
        raise AssertionError

    def close(self) -> None:
        """Do nothing, because nothing is open."""

    def suspend_communication(self) -> None:
        raise AssertionError


class OwnSimulatedCamera:
    """Camera of a simulated laboratory, with the method of the protocol only."""

    lab: FaultyLab

    def latest(self) -> Frame | None:
        return self.lab.mover.plant.camera.latest()


class OwnPointTracker:
    """Tracker of a camera that reports the markers."""

    def find(self, frame: Frame) -> Markers:
        assert frame.points is not None
        return Markers(frame.points.copy(), np.full(2, np.nan), np.ones(2))

    def reset(self) -> None:
        """Do nothing: every frame is searched as the first."""


@pytest.fixture(autouse=True)
def module(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offer the classes as a user's module."""
    own = ModuleType("simulated_devices")
    vars(own).update(globals())
    monkeypatch.setitem(sys.modules, "simulated_devices", own)


def run_check(lab: FaultyLab, file: Path, monkeypatch: pytest.MonkeyPatch) -> CheckReport:
    """Return the report on the own devices of a rig file, opened as the command opens them."""
    for device in (OwnSimulatedArm, OwnSimulatedCamera):
        monkeypatch.setattr(device, "lab", lab, raising=False)
    rig, robot = load_rig_file(file), lab.robot
    robot = Robot(robot.mechanism, robot.tool, read_wiring(rig))
    arm, camera, tracker = open_arm(rig), open_camera(rig), make_tracker(rig)
    mover = Mover(arm, camera, tracker, lab.rig.clock, robot, lab.gate, 0.05, lambda: "")
    return check(mover, lab.operator, robot, lab.thresholds, *read_latency(rig))


def shift_exposures(frame: Frame) -> Frame:
    return replace(frame, exposure=frame.exposure - CLOCK_ERROR_NS)


@pytest.mark.slow
def test_findings_on_own_devices_say_what_their_methods_must_return(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joint 1 of the arm is reversed, and the exposure times are too early."""
    (file := tmp_path / "lab.toml").write_text(RIG)
    lab = FaultyLab(Mistake(factors=(-1.0, 1.0, 1.0)), seed=1, change=shift_exposures)
    report = run_check(lab, file, monkeypatch)
    assert report.done
    times, joint = report.findings
    assert times.what == "the exposure times of the frames contradict the motion"
    assert times.expected.endswith(" s later: middle of the exposure")
    assert abs(float(times.expected.split()[0]) - CLOCK_ERROR_NS * 1e-9) < 0.005
    assert joint.what == "joint 1 contradicts its measured values: it is reversed"
    assert joint.found == "q[0] of measure and rates[0] of apply, as they are"
    assert joint.expected == "q divided and rates multiplied by -1"
    assert (times.where, times.line, joint.where, joint.line) == ("camera", "", "arm", "")
    assert not any("counts" in question for question in lab.operator.questions)


def test_an_own_arm_that_keeps_moving_without_commands_needs_a_watchdog_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(RIG.replace("OwnSimulatedArm", "OwnRateControlledArm"))
    monkeypatch.setattr(Mover, "stops_without_commands", lambda *_: False)
    (finding,) = run_check(FaultyLab(Mistake(), seed=1), file, monkeypatch).findings
    assert (finding.where, finding.line) == ("arm", "")
    assert "let the arm itself stop after the deadline" in finding.expected


WALL_DEVICES = """
import time
import numpy as np
import rcmservo as rs

OPEN = []

class StillArm:
    def enable(self): raise AssertionError
    def apply(self, command): raise AssertionError
    def measure(self):
        return rs.ArmMeasurement(time.monotonic_ns(), np.array([0.6, 0.2, 120.0]), False)
    def close(self): OPEN.append("arm closed")

class GreyCamera:
    frame = rs.Frame(-1, 0, 0)
    def latest(self):
        now = time.monotonic_ns()
        if now > self.frame.exposure + 10_000_000:
            image = np.full((24, 32, 3), 90, np.uint8)
            self.frame = rs.Frame(self.frame.number + 1, now, now, image=image)
        return self.frame

class BlindTracker:
    def find(self, frame):
        return rs.Markers(np.full((2, 2), np.nan), np.full(2, np.nan), np.zeros(2))
    def reset(self): ...
"""


class TerminalWithoutQuestions:
    """Terminal without questions."""

    typed = 0

    def notify(self, message: str) -> None:
        assert message

    def close(self) -> None:
        """Do nothing, because nothing is open."""


def test_the_command_opens_own_devices_and_stores_the_file_as_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The steps of the check are replaced; another test runs them."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(rig_check, "Terminal", TerminalWithoutQuestions)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "wall_lab.py").write_text(WALL_DEVICES)
    (file := tmp_path / "lab.toml").write_text(
        '[arm]\nkind = "wall_lab:StillArm"\n[camera]\nkind = "wall_lab:GreyCamera"\n'
        '[tracker]\nkind = "wall_lab:BlindTracker"\n'
    )
    received: list[Any] = []

    def check_passes(mover: Mover, operator: Any, robot: Robot, *arguments: Any) -> CheckReport:
        received.extend([robot.wiring.key, *arguments[1:]])
        return CheckReport([], done=True)

    monkeypatch.setattr(rig_check, "check", check_passes)
    assert rig_check.rig_check(RigOptions("check", file)) == 0
    assert received == ["", 0.0, False]
    assert sys.modules.pop("wall_lab").OPEN[-1] == "arm closed"
    assert is_rig_verified(compute_digest(file.read_bytes()))
