"""`rcmservo rig check` at a terminal, with the emulated controller and its camera."""

import json
import os
import signal
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from terminal_process import AtTerminal, Laboratory, typed_joints, wait_for

from conftest import INTERRUPTIBLE_COMMAND, SMALL_30_HZ_RIG_TOML
from rcmservo.bringup.axis_wiring import Robot, Wiring
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.findings import Finding
from rcmservo.cli.lab import rig_check
from rcmservo.cli.lab.rig_check import RigOptions, report_result
from rcmservo.config.rig_file import RigDescription
from rcmservo.config.verified_rigs import compute_digest, is_rig_verified, mark_rig_verified
from rcmservo.errors import Stopped
from rcmservo.interfaces import ArmMeasurement, Frame
from rcmservo.loop.run_result import CameraStatistics


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    it = Laboratory(tmp_path_factory.mktemp("laboratory"), seed=1, rig=SMALL_30_HZ_RIG_TOML)
    yield it
    it.close()


def command(lab: Path, *options: str) -> list[str]:
    return [sys.executable, "-c", INTERRUPTIBLE_COMMAND, "rig", "check", str(lab), *options]


def define_joints(terminal: AtTerminal, laboratory: Laboratory) -> None:
    """Type and confirm the joint values."""
    terminal.until("such as 0.1 -0.2 100:")
    terminal.type(typed_joints(laboratory.start) + "\n")
    terminal.until("Press Enter to confirm:")
    terminal.type("\n")


@contextmanager
def check_until_enable(
    laboratory: Laboratory, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> Generator[AtTerminal]:
    """Run the check of a file that passed before up to its first question.

    At the end the drive is off and the file no longer counts as checked.
    """
    laboratory.forget()
    lab = laboratory.lab()
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    digest = compute_digest(lab.read_bytes())
    mark_rig_verified(digest)
    with AtTerminal(command(lab), XDG_STATE_HOME=str(folder)) as terminal:
        define_joints(terminal, laboratory)
        terminal.until("(enable / no)")
        yield terminal
    wait_for(lambda: laboratory.off)
    assert not is_rig_verified(digest)


@pytest.mark.alone
@pytest.mark.slow
def test_a_check_that_is_stopped_during_motion_disables_the_drive_and_revokes_the_pass(
    laboratory: Laboratory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with check_until_enable(laboratory, tmp_path, monkeypatch) as terminal:
        terminal.type("enable\n")
        terminal.until("(yes / no)")
        before = laboratory.counts
        terminal.type("yes\n")
        wait_for(lambda: laboratory.counts != before)
        os.killpg(terminal.process.pid, signal.SIGTERM)
        assert terminal.end() == 1


class GreyCamera:
    """Camera of grey frames."""

    def __init__(self) -> None:
        self.frame, self.closed = Frame(-1, 0, 0), False

    def latest(self) -> Frame:
        now, image = time.monotonic_ns(), np.full((24, 32, 3), 90, np.uint8)
        if now - self.frame.exposure > 10_000_000:
            self.frame = Frame(self.frame.number + 1, now, now, image=image)
        return self.frame

    def counts(self) -> CameraStatistics:
        return CameraStatistics()

    def close(self) -> None:
        self.closed = True


class DisabledArm:
    """Arm whose drive is off."""

    def __init__(self, off_reason: str = "") -> None:
        self.off_reason, self.closed = off_reason, False

    def measure(self) -> ArmMeasurement:
        return ArmMeasurement(time.monotonic_ns(), np.array([0.6, 0.2, 120.0]), False)

    def is_homed(self) -> bool:
        return True

    def close(self) -> None:
        self.closed = True


class SilentTerminal:
    """Terminal without questions."""

    typed = 0

    def notify(self, message: str) -> None:
        assert message

    def close(self) -> None:
        """Do nothing, because nothing is open."""


def is_stopped(*_: Any) -> CheckReport:
    raise Stopped("stopped by SIGTERM, in order")


def passes(*_: Any) -> CheckReport:
    return CheckReport([], done=True)


@pytest.mark.parametrize(
    ("check", "off_reason", "passed"),
    [(passes, "", True), (passes, "its watchdog", False), (is_stopped, "", False)],
)
def test_an_earlier_pass_is_revoked_unless_the_check_passes_completely_again(
    check: Any, off_reason: str, passed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check is replaced; the devices are closed in every case."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(rig_check, "Terminal", SilentTerminal)
    monkeypatch.setattr(rig_check, "check", check)
    (file := tmp_path / "lab.toml").write_text(
        '[arm]\nkind = "galil"\naddress = "127.0.0.1"\ncounts = [1e5, 1e5, 1e3]\n'
        '[camera]\nkind = "opencv"\nsource = "0"\nlatency = 0.02\n'
    )
    digest, arm, camera = compute_digest(file.read_bytes()), DisabledArm(off_reason), GreyCamera()
    mark_rig_verified(digest)
    try:
        code = rig_check.rig_check(RigOptions("check", file), lambda lab: arm, lambda lab: camera)
        assert code == (0 if passed else 1)
    except Stopped:
        assert check is is_stopped
    assert is_rig_verified(digest) == passed and arm.closed and camera.closed


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize("ok", [False, True])
def test_a_file_is_stored_as_passed_only_without_findings(
    ok: bool, as_json: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    lab = RigDescription()
    robot = Robot(lab.mechanism, lab.tool, Wiring((1.0, 1.0, 1.0)))
    findings = [] if ok else [Finding("the picture is mirrored", "camera", "so", "otherwise")]
    options = RigOptions("check", Path("lab.toml"), as_json)
    code = report_result(options, CheckReport(findings, done=True), robot, "0" * 64)
    assert (code == 0) == ok == is_rig_verified("0" * 64)
    output = capsys.readouterr().out
    assert ("mirrored" in output) == (not ok)
    assert not as_json or json.loads(output)["ok"] == ok
