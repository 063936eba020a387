"""`rcmservo rig check` at a terminal, against the emulated controller and its camera."""

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
from at_terminal import AtTerminal, Laboratory, wait_for, words_of

from conftest import HEEDING_CTRL_C, SMALL
from rcmservo.bringup.axis_wiring import Robot, Wiring
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.findings import Finding
from rcmservo.cli.lab import rig_check
from rcmservo.cli.lab.rig_check import RigOptions, conclude
from rcmservo.config.rig_file import Lab
from rcmservo.config.verified_rigs import digest_of, is_checked, note_checked
from rcmservo.errors import Stopped
from rcmservo.interfaces import Frame, Measured
from rcmservo.loop.run_result import CameraAccount


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    it = Laboratory(tmp_path_factory.mktemp("laboratory"), seed=1, rig=SMALL)
    yield it
    it.close()


def command(lab: Path, *options: str) -> list[str]:
    return [sys.executable, "-c", HEEDING_CTRL_C, "rig", "check", str(lab), *options]


def stands(person: AtTerminal, laboratory: Laboratory) -> None:
    """The person says where the arm stands."""
    person.until("such as 0.1 -0.2 100:")
    person.type(words_of(laboratory.start) + "\n")
    person.until("Enter if so:")
    person.type("\n")


@contextmanager
def asked_to_enable(
    laboratory: Laboratory, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> Generator[AtTerminal]:
    """A check up to its first question, of a file that has passed once: that counts no more in the
    end, and the arm is off.
    """
    laboratory.forget()
    lab = laboratory.lab()
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    digest = digest_of(lab.read_bytes())
    note_checked(digest)
    with AtTerminal(command(lab), XDG_STATE_HOME=str(folder)) as person:
        stands(person, laboratory)
        person.until("(enable / no)")
        yield person
    wait_for(lambda: laboratory.off)
    assert not is_checked(digest)


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_whatever_ends_it_in_a_motion_the_arm_is_off_and_what_passed_before_counts_no_more(
    laboratory: Laboratory, tmp_path: Path, how: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    with asked_to_enable(laboratory, tmp_path, monkeypatch) as person:
        person.type("enable\n")
        person.until("(yes / no)")
        then = laboratory.counts
        person.type("yes\n")
        wait_for(lambda: laboratory.counts != then)
        os.killpg(person.process.pid, how)
        assert person.end() == (130 if how == signal.SIGINT else 1)


class Seen:
    """A camera of grey frames."""

    def __init__(self) -> None:
        self.frame, self.closed = Frame(-1, 0, 0), False

    def latest(self) -> Frame:
        now, image = time.monotonic_ns(), np.full((24, 32, 3), 90, np.uint8)
        if now - self.frame.exposure > 10_000_000:
            self.frame = Frame(self.frame.number + 1, now, now, image=image)
        return self.frame

    def account(self) -> CameraAccount:
        return CameraAccount()

    def close(self) -> None:
        self.closed = True


class Off:
    """An arm whose drive is off."""

    def __init__(self, why_off: str = "") -> None:
        self.why_off, self.closed = why_off, False

    def measure(self) -> Measured:
        return Measured(time.monotonic_ns(), np.array([0.6, 0.2, 120.0]), False)

    def homed(self) -> bool:
        return True

    def close(self) -> None:
        self.closed = True


class Quiet:
    """A terminal at which nobody is asked."""

    typed = 0

    def tell(self, words: str) -> None:
        assert words

    def close(self) -> None:
        """Nothing is open."""


def stopped_at_once(*_: Any) -> CheckReport:
    raise Stopped("stopped by SIGTERM, in order")


def all_right(*_: Any) -> CheckReport:
    return CheckReport([], done=True)


@pytest.mark.parametrize(
    ("check", "why_off", "passed"),
    [(all_right, "", True), (all_right, "its watchdog", False), (stopped_at_once, "", False)],
)
def test_a_file_that_passed_once_counts_no_more_unless_it_passes_again_to_the_end(
    check: Any, why_off: str, passed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, with a check that is given; the devices are closed whatever it does."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr(rig_check, "Terminal", Quiet)
    monkeypatch.setattr(rig_check, "check", check)
    (file := tmp_path / "lab.toml").write_text(
        '[arm]\nkind = "galil"\naddress = "127.0.0.1"\ncounts = [1e5, 1e5, 1e3]\n'
        '[camera]\nkind = "opencv"\nsource = "0"\nlatency = 0.02\n'
    )
    digest, arm, camera = digest_of(file.read_bytes()), Off(why_off), Seen()
    note_checked(digest)
    try:
        code = rig_check.rig_check(RigOptions("check", file), lambda lab: arm, lambda lab: camera)
        assert code == (0 if passed else 1)
    except Stopped:
        assert check is stopped_at_once
    assert is_checked(digest) == passed and arm.closed and camera.closed


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize("right", [False, True])
def test_a_file_is_noted_as_passed_only_where_nothing_was_found(
    right: bool, as_json: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    lab = Lab()
    robot = Robot(lab.mechanism, lab.tool, Wiring((1.0, 1.0, 1.0)))
    wrong = [] if right else [Finding("the picture is mirrored", "camera", "so", "otherwise")]
    options = RigOptions("check", Path("lab.toml"), as_json)
    code = conclude(options, CheckReport(wrong, done=True), robot, "0" * 64)
    assert (code == 0) == right == is_checked("0" * 64)
    said = capsys.readouterr().out
    assert ("mirrored" in said) == (not right)
    assert not as_json or json.loads(said)["ok"] == right
