"""`rcmservo rig check` at a terminal, against the emulated controller and its camera."""

import json
import os
import re
import signal
import sys
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from at_terminal import AtTerminal, Ended, Laboratory, wait_for, words_of

from bring_up_page import answer_to
from conftest import HEEDING_CTRL_C, SMALL, first_quick
from rcmservo.app.lab.emulate import COUNTS
from rcmservo.app.lab.rig_check import RigOptions, concluded
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.wiring import Finding, Robot, Wiring
from rcmservo.config.checked import digest_of, is_checked, note_checked
from rcmservo.config.rig_file import Lab
from stalls import undisturbed

pytestmark = pytest.mark.alone


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
    end, and the arm is off."""
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


def test_no_moves_nothing_and_ends_with_the_drive_off(
    laboratory: Laboratory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with asked_to_enable(laboratory, tmp_path, monkeypatch) as person:
        before = laboratory.counts, laboratory.sessions
        person.type("no\n")
        assert person.end() == 1
        assert "person" in person.shown
        assert (laboratory.counts, laboratory.sessions) == before
        assert laboratory.off


@pytest.mark.parametrize("how", first_quick([signal.SIGTERM, signal.SIGHUP, signal.SIGINT]))
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
    code = concluded(options, CheckReport(wrong, done=True), robot, "0" * 64)
    assert (code == 0) == right == is_checked("0" * 64)
    said = capsys.readouterr().out
    assert ("mirrored" in said) == (not right)
    assert not as_json or json.loads(said)["ok"] == right


@pytest.mark.slow
def test_a_reversed_joint_is_named_with_its_line(tmp_path: Path) -> None:
    def attempt() -> tuple[dict[str, Any], float]:
        with closing(Laboratory(tmp_path, seed=3)) as laboratory:
            lab = laboratory.lab()
            wrong = [COUNTS[0], -COUNTS[1], COUNTS[2]]
            lab.write_text(lab.read_text().replace(str(list(COUNTS)), str(wrong)))
            try:
                told = checked(laboratory, lab, tmp_path)
            except Ended as early:
                told = json.loads(early.told)
            assert not told["ok"] and laboratory.off
            return told, np.abs(laboratory.counts - laboratory.start * wrong).max()

    told, away = undisturbed(attempt, lambda run: not stopped(run[0]))
    assert f"counts = {list(COUNTS)}" in [one["line"] for one in told["findings"]], told
    assert away < 1000.0


@pytest.mark.slow
def test_the_tutorial_of_the_bring_up_page_can_be_followed_to_its_end(tmp_path: Path) -> None:
    """With the emulator's ports and patient thresholds in the page's rig file."""

    def attempt() -> tuple[str, int]:
        with closing(Laboratory(tmp_path, seed=3)) as laboratory:
            lab = laboratory.lab()
            lab.write_text(lab.read_text().replace("latency = 0.02\n", ""))
            first, code = followed(command(lab), laboratory.printed, tmp_path)
            line = re.search(r"latency = [\d.]+", first)
            if line is None:
                return first, code
            lab.write_text(lab.read_text().replace("[camera]\n", f"[camera]\n{line[0]}\n"))
            return followed(command(lab), laboratory.printed, tmp_path)

    shown, code = undisturbed(attempt, lambda run: run[1] == 0)
    assert code == 0 and "all is as the rig file says" in shown, shown


def followed(words: list[str], printed: str, folder: Path) -> tuple[str, int]:
    """What a command shows to a reader of the page who types its answers, and its exit code."""
    with AtTerminal(words, XDG_STATE_HOME=str(folder)) as person:
        while question := person.question():
            person.type(answer_to(question, printed) + "\n")
        return person.shown, person.end()


def stopped(told: dict[str, Any]) -> bool:
    """Whether the arm's watchdog ended the check."""
    return any(one["where"] == "arm" and "drive" in one["what"] for one in told["findings"])


def checked(laboratory: Laboratory, lab: Path, folder: Path) -> dict[str, Any]:
    """What the command tells of a lab whose second joint is reversed, the person agreeing to all
    and saying what the tool did truly."""
    ways = {"joint 1": "away\n", "joint 2": "anticlockwise\n"}
    with AtTerminal(command(lab, "--json"), json=True, XDG_STATE_HOME=str(folder)) as person:
        stands(person, laboratory)
        person.until("(enable / no)")
        person.type("enable\n")
        asked = ""
        while "For joint 2" not in asked:
            asked = person.until(") ")
            if asked.rstrip().endswith("(yes / no)"):
                person.type("yes\n")
            elif asked.rstrip().endswith("/ again)"):
                person.type(next(way for name, way in ways.items() if f"For {name}" in asked))
        person.end()
        assert person.process.stdout is not None
        return json.loads(person.process.stdout.read())
