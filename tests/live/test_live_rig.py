"""`rcmservo live --rig lab.toml` at a terminal, against the emulated controller and its camera over
the network. The emulator is asked over a connection of its own whether anything moved."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from at_terminal import PATIENCE, AtTerminal, Laboratory, live, wait_for, words_of

from conftest import ROOT, SMALL, first_quick
from rcmservo.app.cli import asked_of
from rcmservo.app.lab.live_on_hardware import require_devices
from rcmservo.config.checked import digest_of, note_checked
from rcmservo.config.rig_file import load_lab
from rcmservo.config.target_file import Setup, save
from rcmservo.interfaces import Target
from rcmservo.method.tool import RigidTool
from rcmservo.record.reader import read
from rcmservo.sim import Rig
from stalls import undisturbed

pytestmark = pytest.mark.alone

STANDS = "such as 0.1 -0.2 100: "
SO = "Enter if so: "
TARGET = "Bring the tool to the target by hand, then press Enter: "
START = "Bring the tool to its start by hand, then press Enter: "
WORD = "anything else ends this: "

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


def test_its_page_shows_a_file_and_commands_that_are_understood(tmp_path: Path) -> None:
    """The other tests run them, on ports that are free."""
    page = (ROOT / "docs/live_on_hardware.md").read_text()
    (path := tmp_path / "lab.toml").write_text(page.split("```toml\n")[1].split("```")[0])
    require_devices(load_lab(path), path, "")
    told = [block.split("```")[0].split() for block in page.split("```sh\n")[1:]]
    assert [words[:2] for words in told] == [
        [".venv/bin/rcmservo", "emulate"],
        [".venv/bin/rcmservo", "live"],
    ]
    for words in told:
        asked_of(words[1], words[2:])
    assert f"`{' '.join(f'{x:.4f}' for x in Rig(0).scene.start[:2])} " in page


# ---------------------------------------------------------------- refused


def test_without_a_terminal_nothing_is_connected(lab: Laboratory, tmp_path: Path) -> None:
    """Words from a script come by the standard input."""
    command = live(lab.lab(), "--out", str(tmp_path / "out"))
    with unmoved(lab):
        done = subprocess.run(
            command, input=b"\n\nenable\n", capture_output=True, start_new_session=True, check=False
        )
    assert done.returncode == 2
    words = "hardware is enabled only by a person at a terminal, and this program has none"
    assert done.stderr.decode() == f"rcmservo: {words}\n"
    assert not (tmp_path / "out").exists()


def test_another_word_and_words_typed_ahead_enable_nothing(lab: Laboratory, tmp_path: Path) -> None:
    lab.forget()
    lab.bring(lab.start)
    with unmoved(lab), at_terminal(lab, tmp_path) as at:
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
        then = lab.counts
        at.type("yes\n")
        assert at.end() == 1
        assert lab.counts == then
        assert not (tmp_path / "out").exists()
        assert "rcmservo: nothing was switched on: the answer was not enable\n" in at.shown


def test_a_controller_that_is_not_there_is_one_sentence(lab: Laboratory, tmp_path: Path) -> None:
    path = lab.lab()
    path.write_text(path.read_text().replace(f"port = {lab.port}", "port = 1"))
    with AtTerminal(live(path, "--out", str(tmp_path / "out"))) as at:
        assert at.end() == 2
    assert "\nrcmservo: 127.0.0.1:1 cannot be reached: " in at.shown
    assert "Traceback" not in at.shown


QUESTIONS = WORD, STANDS, SO, TARGET, START


@pytest.mark.slow
@pytest.mark.parametrize("question", QUESTIONS)
@pytest.mark.parametrize(("typed", "code"), [("\x03", 130), ("\x04", 1)])
def test_a_person_can_end_it_at_every_question(
    lab: Laboratory, tmp_path: Path, question: str, typed: str, code: int
) -> None:
    lab.forget()
    with unmoved(lab), at_terminal(lab, tmp_path) as at:
        for asked in (STANDS, SO, TARGET, START, WORD):
            at.until(asked)
            if asked == question:
                break
            at.type(f"{words_of(lab.start)}\n" if asked == STANDS else "\n")
        at.type(typed)
        assert at.end() == code
    assert "Traceback" not in at.shown
    assert lab.homed == (question not in (STANDS, SO))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_target_of_another_rig_is_refused_before_anything_is_asked(
    lab: Laboratory, tmp_path: Path
) -> None:
    known = load_lab(lab.lab())
    setup = Setup("another", 320, 240, known.mechanism, known.tool, known.markers)
    setup = replace(setup, tool=RigidTool(spacing=31.0))
    target = Target(np.array([[100.0, 100.0], [120.0, 150.0]]), lab.target)
    save(tmp_path / "target.json", target, setup)
    with unmoved(lab), at_terminal(lab, tmp_path, "--target", str(tmp_path / "target.json")) as at:
        assert at.end() == 2
    assert "was taught with camera" in at.shown and "by hand" not in at.shown


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


ENDS = {
    "window closed": (1, 2),
    signal.SIGINT: (130, 1),
    signal.SIGTERM: (1,),
    signal.SIGHUP: (1,),
}
"""What ends it, and the exit codes that may come of it."""


@pytest.mark.parametrize("how", first_quick(list(ENDS)))
def test_whatever_ends_it_the_arm_is_off_at_rest_and_the_record_is_whole(
    lab: Laboratory, tmp_path: Path, how: Any
) -> None:
    """A machine that stands still may stop the arm before: that leaves the same."""
    with at_terminal(lab, tmp_path) as at:
        led(at, lab)
        begun(at, lab)
        if isinstance(how, str):
            at.hang_up()
        else:
            os.killpg(at.process.pid, how)
        assert at.process.wait(PATIENCE) in ENDS[how]
    wait_for(lambda: at_rest(lab))
    assert read(tmp_path / "out").complete


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


@pytest.mark.slow
@pytest.mark.parametrize("checked", [False, True])
def test_it_goes_to_the_target_at_the_speed_that_its_file_has_earned(
    lab: Laboratory, tmp_path: Path, checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    if checked:
        note_checked(digest_of(lab.lab().read_bytes()))
    folders = (tmp_path / name for name in "abcdef")

    def attempt() -> tuple[Path, dict[str, Any]]:
        folder = next(folders)
        kept = ["--save-target", str(folder / "target.json"), "--out", str(folder / "out")]
        folder.mkdir()
        with AtTerminal(live(lab.lab(), *kept), XDG_STATE_HOME=str(tmp_path)) as at:
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
    assert metrics["simulated"] is False and "pose_error_mm" not in metrics
    assert metrics["camera"]["frames"] > 100 and (folder / "target.json").is_file()
    record = read(folder / "out")
    share = 1.0 if checked else 0.1
    speeds = np.abs(record.ticks["command"]) / np.array(load_lab(lab.lab()).gate.speed)
    assert metrics["speed_share"] == share and speeds.max() <= share * (1.0 + 1e-9)
    assert (np.abs(lab.q - lab.target) < np.array([0.03, 0.03, 2.0])).all()
