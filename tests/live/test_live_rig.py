"""`rcmservo live --rig lab.toml` at a terminal, against the emulated controller and its camera over
the network. The emulator is asked over a connection of its own whether anything moved.
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
from at_terminal import PATIENCE, AtTerminal, Laboratory, live, wait_for, words_of

from conftest import ROOT, SMALL
from rcmservo.cli.cli import asked_of, main
from rcmservo.cli.lab.live_on_hardware import require_devices
from rcmservo.config.rig_file import load_lab
from rcmservo.config.verified_rigs import digest_of, note_checked
from rcmservo.live import terminal_operator
from rcmservo.recording.reader import read_record
from rcmservo.sim import Rig
from stalls import undisturbed

PAGE = (ROOT / "docs/live_on_hardware.md").read_text()
STANDS = "such as 0.1 -0.2 100: "
SO = "Enter if so: "
TARGET = "Bring the tool to the target by hand, then press Enter: "
START = "Bring the tool to its start by hand, then press Enter: "
WORD = "anything else ends this: "

SECONDS = "12"
"""s of a run that settles."""

NEAR = np.array([0.005, 0.005, 0.3])
"""rad, rad, mm within which the hand brings the arm to a place."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laboratory]:
    with closing(Laboratory(tmp_path_factory.mktemp("lab"), 1, SMALL)) as lab:
        lab.ask("MO ABC")
        yield lab


@contextmanager
def unmoved(lab: Laboratory) -> Iterator[None]:
    """In here the drive is never on, and nothing moves but by the hand, which brings it back."""
    then, sessions = lab.q, lab.sessions
    yield
    assert lab.off and lab.sessions == sessions
    assert (np.abs(lab.q - then) <= NEAR).all()


def led(at: AtTerminal, lab: Laboratory) -> None:
    """A person answers everything but the last question."""
    if not lab.homed:
        at.until(STANDS)
        at.type(f"{words_of(lab.start)}\n")
        at.until(SO)
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
    """The rig file that the page shows."""
    return PAGE.split("```toml\n")[1].split("```")[0]


def test_its_page_shows_a_file_and_commands_that_are_understood(tmp_path: Path) -> None:
    """The other tests run them, on ports that are free."""
    (path := tmp_path / "lab.toml").write_text(page_block())
    require_devices(load_lab(path), path, "")
    told = [block.split("```")[0].split() for block in PAGE.split("```sh\n")[1:]]
    assert [words[:2] for words in told] == [
        [".venv/bin/rcmservo", "emulate"],
        [".venv/bin/rcmservo", "live"],
    ]
    for words in told:
        asked_of(words[1], words[2:])
    assert f"`{' '.join(f'{x:.4f}' for x in Rig(0).scene.start[:2])} " in PAGE


# ---------------------------------------------------------------- refused


def test_without_a_terminal_nothing_is_connected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody listens at the addresses in its file: that would be another sentence."""
    (path := tmp_path / "lab.toml").write_text(page_block())
    monkeypatch.setattr(terminal_operator, "TERMINAL", tmp_path / "none")
    assert main(["live", "--rig", str(path), "--out", str(tmp_path / "out")]) == 2
    words = "hardware is enabled only by a person at a terminal, and this program has none"
    assert capsys.readouterr().err == f"rcmservo: {words}\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "typed", "code", "words"),
    [
        (WORD, "\x03", 130, ""),
        (WORD, "yes\n", 1, "rcmservo: nothing was switched on: the answer was not enable\n"),
        (STANDS, "\x04", 1, "rcmservo: ended at the terminal, before the drive was on\n"),
    ],
)
def test_a_person_ends_it_before_anything_moved(
    lab: Laboratory, tmp_path: Path, asked: str, typed: str, code: int, words: str
) -> None:
    """At each other question too, as test_at_the_arm.py has it."""
    lab.forget()
    with unmoved(lab), at_terminal(lab, tmp_path) as at:
        for question in (STANDS, SO, TARGET, START, WORD):
            at.until(question)
            if question == asked:
                break
            at.type(f"{words_of(lab.start)}\n" if question == STANDS else "\n")
        at.type(typed)
        assert at.end() == code
    assert words in at.shown and "Traceback" not in at.shown
    assert lab.homed == (asked != STANDS)
    assert not (tmp_path / "out").exists()


# ---------------------------------------------------------------- moved


def begun(at: AtTerminal, lab: Laboratory) -> None:
    """The person types the word, and the arm moves."""
    then = lab.counts
    at.type("enable\n")
    wait_for(lambda: lab.counts != then or at.process.poll() is not None)


def at_rest(lab: Laboratory) -> bool:
    """Whether the motors are off and stay so, and the arm stands."""
    then = lab.counts
    return lab.off and then == lab.counts == lab.counts


@pytest.mark.alone
def test_ctrl_c_in_a_motion_leaves_the_arm_off_at_rest_and_the_record_whole(
    lab: Laboratory, tmp_path: Path
) -> None:
    """What was typed ahead answers nothing before, and joints that cannot be are refused. A machine
    that stands still may stop the arm before Ctrl-C: that leaves the same.
    """
    lab.forget()
    lab.bring(lab.start)
    with at_terminal(lab, tmp_path) as at:
        at.until("preparing")
        at.type("\n\n\nenable\nenable\n")
        at.until(STANDS)
        at.type("somewhere\n")
        at.until("three numbers (rad, rad, mm)")
        at.until(STANDS)
        at.type(f"{words_of(lab.start + np.array([9.0, 0.0, 0.0]))}\n")
        at.until("the joints must be within theta")
        led(at, lab)
        assert "0.1 rad/s, 0.1 rad/s and 8 mm/s, which is 10 % of the full speed" in at.shown
        assert lab.off
        begun(at, lab)
        os.killpg(at.process.pid, signal.SIGINT)
        assert at.end() in (130, 1)  # and no process of it holds the terminal any more
    wait_for(lambda: at_rest(lab))
    record = read_record(tmp_path / "out")
    speeds = np.abs(record.ticks["command"]) / np.array(load_lab(lab.lab()).gate.speed)
    assert record.complete and 0.0 < speeds.max() <= 0.1 * (1.0 + 1e-9)


@pytest.mark.alone
@pytest.mark.slow
def test_a_window_that_is_closed_in_a_motion_leaves_the_same(
    lab: Laboratory, tmp_path: Path
) -> None:
    with at_terminal(lab, tmp_path) as at:
        led(at, lab)
        begun(at, lab)
        at.hang_up()
        assert at.process.wait(PATIENCE) in (1, 2)
    wait_for(lambda: at_rest(lab))
    assert read_record(tmp_path / "out").complete


@pytest.mark.alone
@pytest.mark.slow
def test_a_controller_that_falls_silent_is_told_in_words(lab: Laboratory, tmp_path: Path) -> None:
    with at_terminal(lab, tmp_path) as at:
        led(at, lab)
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
def test_it_goes_to_the_target_at_the_full_speed_that_a_checked_file_has_earned(
    lab: Laboratory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    note_checked(digest_of(lab.lab().read_bytes()))
    folders = (tmp_path / name for name in "abcdef")

    def attempt() -> tuple[Path, dict[str, Any]]:
        folder = next(folders)
        kept = ["--save-target", str(folder / "target.json"), "--out", str(folder / "out")]
        folder.mkdir()
        command = live(lab.lab(), *kept, "--duration", SECONDS)
        with AtTerminal(command, XDG_STATE_HOME=str(tmp_path)) as at:
            led(at, lab)
            at.type("enable\n")
            code = at.end()
        wait_for(lambda: at_rest(lab))
        if code == 2:  # a drive that does not come on in time is a sentence, and no run
            return folder, {"settled": False, "said": at.shown}
        metrics = json.loads((folder / "out/metrics.json").read_text())
        assert code == (0 if metrics["settled"] else 1)
        return folder, metrics

    folder, metrics = undisturbed(attempt, lambda run: run[1]["settled"])
    assert metrics["settled"], json.dumps(metrics)
    assert metrics["simulated"] is False and metrics["pose_error_mm"] is None
    assert metrics["camera"]["frames"] > 100 and (folder / "target.json").is_file()
    assert metrics["speed_share"] == 1.0 and read_record(folder / "out").complete
    assert (np.abs(lab.q - lab.target) < np.array([0.03, 0.03, 2.0])).all()
