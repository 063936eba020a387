"""`rcmservo live --rig lab.toml` at a terminal, with an emulated controller and camera.

A second connection to the emulator shows whether the arm moved.
"""

import json
import os
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from terminal_process import WAIT_TIMEOUT_S, AtTerminal, Laboratory, live, typed_joints, wait_for

import rcmservo as rs
from conftest import ROOT, SMALL_30_HZ_RIG_TOML
from rcmservo.cli.cli import main, parse_command_options
from rcmservo.config.rig_file import load_rig_file
from rcmservo.config.verified_rigs import compute_digest, mark_rig_verified
from rcmservo.hardware.lab_rig import require_devices
from rcmservo.live import terminal_operator
from rcmservo.recording.reader import read_record
from rcmservo.sim import Rig
from stalls import retry_after_stalls

PAGE = (ROOT / "docs/live_on_hardware.md").read_text()
JOINTS = "such as 0.1 -0.2 100: "
CONFIRM = "Press Enter to confirm: "
TARGET = "Move the tool to the target by hand, then press Enter: "
START = "Move the tool to its start by hand, then press Enter: "
WORD = "any other answer ends the program: "

HAND_TOLERANCE = np.array([0.005, 0.005, 0.3])
"""Tolerance in rad, rad, mm of a motion by hand."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    with closing(Laboratory(tmp_path_factory.mktemp("lab"), 1, SMALL_30_HZ_RIG_TOML)) as lab:
        lab.ask("MO ABC")
        yield lab


@contextmanager
def unmoved(lab: Laboratory) -> Iterator[None]:
    """Check that the drive is never on and that only the hand moves the arm, and returns it."""
    before, sessions = lab.q, lab.sessions
    yield
    assert lab.off and lab.sessions == sessions
    assert (np.abs(lab.q - before) <= HAND_TOLERANCE).all()


def answer_until_enable(at: AtTerminal, lab: Laboratory) -> None:
    """Answer all questions except the last."""
    if not lab.homed:
        at.until(JOINTS)
        at.type(f"{typed_joints(lab.start)}\n")
        at.until(CONFIRM)
        at.type("\n")
    at.until(TARGET)
    lab.bring(lab.target)
    at.type("\n")
    at.until(START)
    lab.bring(lab.start)
    at.type("\n")
    at.until(WORD)


def at_terminal(lab: Laboratory, folder: Path, *options: str, more: str = "") -> AtTerminal:
    out = "--out", str(folder / "out"), *options
    return AtTerminal(live(lab.lab(more), *out), XDG_STATE_HOME=str(folder))


def page_block() -> str:
    """Return the rig file of the documentation."""
    return PAGE.split("```toml\n")[1].split("```")[0]


def test_the_documented_rig_file_and_commands_are_valid(tmp_path: Path) -> None:
    """Other tests run the commands, on free ports."""
    (path := tmp_path / "lab.toml").write_text(page_block())
    require_devices(load_rig_file(path), path, "")
    commands = [block.split("```")[0].split() for block in PAGE.split("```sh\n")[1:]]
    assert [words[:2] for words in commands] == [
        [".venv/bin/rcmservo", "emulate"],
        [".venv/bin/rcmservo", "live"],
    ]
    for words in commands:
        parse_command_options(words[1], words[2:])
    assert f"`{' '.join(f'{x:.4f}' for x in Rig(0).scene.start[:2])} " in PAGE


def test_without_a_terminal_nothing_is_connected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing listens at the addresses of the file, so a connection would give another message."""
    (path := tmp_path / "lab.toml").write_text(page_block())
    monkeypatch.setattr(terminal_operator, "TERMINAL", tmp_path / "none")
    assert main(["live", "--rig", str(path), "--out", str(tmp_path / "out")]) == 2
    words = "hardware is enabled only by an operator at a terminal, and this program has none"
    assert capsys.readouterr().err == f"rcmservo: {words}\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "code", "words"),
    [
        ("\x03", 130, ""),
        ("yes\n", 1, "rcmservo: the drive was not switched on: the answer was not enable\n"),
    ],
)
def test_the_operator_ends_the_program_before_any_motion(
    lab: Laboratory, tmp_path: Path, typed: str, code: int, words: str
) -> None:
    """`test_hardware_prompts.py` tests the other questions, `test_terminal_operator.py` Ctrl-D."""
    lab.forget()
    with unmoved(lab), at_terminal(lab, tmp_path) as at:
        for question in (JOINTS, CONFIRM, TARGET, START, WORD):
            at.until(question)
            answer = f"{typed_joints(lab.start)}\n" if question == JOINTS else "\n"
            at.type(typed if question == WORD else answer)
        assert at.end() == code
    assert words in at.shown and "Traceback" not in at.shown
    assert lab.homed
    assert not (tmp_path / "out").exists()


def enable_and_move(at: AtTerminal, lab: Laboratory) -> None:
    """Type the word and wait until the arm moves."""
    before = lab.counts
    at.type("enable\n")
    wait_for(lambda: lab.counts != before or at.process.poll() is not None)


def at_rest(lab: Laboratory) -> bool:
    """Return True if the motors are off and the arm is at rest."""
    before = lab.counts
    return lab.off and before == lab.counts == lab.counts


@pytest.mark.slow
def test_ctrl_c_during_motion_leaves_the_drive_off_and_the_record_complete(
    lab: Laboratory, tmp_path: Path
) -> None:
    """Input typed ahead answers no question, and invalid joints are refused.

    A stalled computer may stop the arm before Ctrl-C, with the same result.
    """
    lab.forget()
    lab.bring(lab.start)
    with at_terminal(lab, tmp_path) as at:
        at.until("preparing")
        at.type("\n\n\nenable\nenable\n")
        at.until(JOINTS)
        at.type("somewhere\n")
        at.until("three numbers (rad, rad, mm)")
        at.until(JOINTS)
        at.type(f"{typed_joints(lab.start + np.array([9.0, 0.0, 0.0]))}\n")
        at.until("the joints must be within theta")
        answer_until_enable(at, lab)
        assert "0.1 rad/s, 0.1 rad/s and 8 mm/s, which is 10 % of the full speed" in at.shown
        assert lab.off
        enable_and_move(at, lab)
        os.killpg(at.process.pid, signal.SIGINT)
        assert at.end() in (130, 1)  # and none of its processes holds the terminal
    wait_for(lambda: at_rest(lab))
    record = read_record(tmp_path / "out")
    speeds = np.abs(record.ticks["command"]) / np.array(load_rig_file(lab.lab()).gate.speed)
    assert record.complete and 0.0 < speeds.max() <= 0.1 * (1.0 + 1e-9)


@pytest.mark.slow
def test_a_terminal_closed_during_motion_leaves_the_drive_off_and_the_record_complete(
    lab: Laboratory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rig file is checked, so the full speed is allowed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    mark_rig_verified(compute_digest(lab.lab().read_bytes()))
    target = tmp_path / "target.json"
    with at_terminal(lab, tmp_path, "--save-target", str(target)) as at:
        answer_until_enable(at, lab)
        assert "the full speed, because `rcmservo rig check` has passed" in at.shown
        enable_and_move(at, lab)
        at.hang_up()
        assert at.process.wait(WAIT_TIMEOUT_S) in (1, 2)
    wait_for(lambda: at_rest(lab))
    record = read_record(tmp_path / "out")
    assert record.complete and record.about["speed_scale"] == 1.0 and target.is_file()


@pytest.mark.slow
def test_a_silent_controller_is_reported_in_words(lab: Laboratory, tmp_path: Path) -> None:
    with at_terminal(lab, tmp_path) as at:
        answer_until_enable(at, lab)
        at.type("enable\n")
        at.until("0.00 s  ")
        lab.process.send_signal(signal.SIGSTOP)
        try:
            assert at.end() == 1
        finally:
            lab.process.send_signal(signal.SIGCONT)
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert not metrics["settled"] and metrics["drive_off"]
    assert metrics["drive_off"].split(";")[0] in " ".join(at.shown.replace("│", " ").split())
    lab.reach()
    wait_for(lambda: at_rest(lab))


@pytest.mark.alone
@pytest.mark.slow
def test_a_program_of_a_few_lines_runs_the_rig_file_to_the_target(
    lab: Laboratory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    mark_rig_verified(compute_digest(lab.lab().read_bytes()))
    folders, questions = (tmp_path / name for name in "abcdef"), list[str]()

    def confirm(question: str) -> str:
        questions.append(question)
        return "enable"

    def attempt() -> rs.RecordedResult:
        rig = rs.load_rig(lab.lab())
        assert "not connected, at 100 % of the full speed" in str(rig)
        with rig:
            lab.bring(lab.target)
            rig.arm.set_position(lab.target)  # type: ignore[attr-defined]
            assert "drive off" in str(rig) and lab.off
            target = rig.teach(30)
            lab.bring(lab.start)
            options: Any = {"record": next(folders), "confirm": confirm}
            return rs.run(rig, rs.Servo(), target, duration=5.0, **options)

    result = retry_after_stalls(attempt, lambda run: run.settled)
    assert result.settled, str(result)
    assert not result.simulated and result.pose_error_mm is None and "by the joints" in str(result)
    assert result.camera is not None and result.camera.frames > 30
    assert result.record.complete and result.record.about["devices"]["arm"]["kind"] == "galil"
    assert "The joints move at most at" in questions[0]
    wait_for(lambda: at_rest(lab))
    assert (np.abs(lab.q - lab.target) < np.array([0.03, 0.03, 2.0])).all()
