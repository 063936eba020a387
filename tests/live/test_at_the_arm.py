"""The questions to the operator at the arm: a terminal whose answers are given, and an arm of a few
lines. `test_terminal_person.py` tests the terminal itself.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcmservo.cli.lab import hardware_prompts
from rcmservo.cli.lab.hardware_prompts import (
    MAX_ANSWER_AGE_NS,
    AttendedTerminal,
    HardwarePreparation,
    confirm_enable,
    define,
    obtain_target,
    target_setup_for_size,
    teach_by_hand,
)
from rcmservo.config.rig_file import Lab
from rcmservo.config.target_file import save
from rcmservo.errors import Stopped, UnusableFile
from rcmservo.geometry.tool import RigidTool
from rcmservo.interfaces import Floats, Measured, Target
from rcmservo.live.device_protocols import NotReady
from rcmservo.live.servo_process import HeartbeatPlant
from rcmservo.loop.clock import RecordingClock, WallClock

WORD, JOINTS, SO = "ends this:", "0.1 -0.2 100:", "Enter if so:"
TARGET, START = (
    "to the target by hand, then press Enter:",
    "to its start by hand, then press Enter:",
)
LAB = Lab(devices={"camera": {"kind": "opencv", "source": "0"}})
STANDS = "theta 0.6 rad, phi 0.2 rad, rho 120 mm"


class Answered:
    """A terminal at which each question gets the next answer: words, and how many ns before now
    they were typed at the earliest. After the last answer the terminal is ended by Ctrl-D.
    """

    def __init__(self, *answers: str | tuple[str, int]) -> None:
        self._answers = [(one, 0) if isinstance(one, str) else one for one in answers]
        self.typed, self.closed = 0, False
        self.said: list[str] = []

    def tell(self, words: str) -> None:
        self.said.append(words)

    def ask(self, question: str) -> str:
        self.said.append(question)
        if not self._answers:
            raise Stopped("ended at the terminal, before the drive was on")
        words, age = self._answers.pop(0)
        self.typed = time.monotonic_ns() - age
        return words.strip()

    def close(self) -> None:
        assert not self._answers, "not all was asked"
        self.closed = True


class Arm:
    def __init__(self, enabled: bool = False, deaf: bool = False) -> None:
        self.q, self.enabled, self.deaf = np.array([0.6, 0.2, 120.0]), enabled, deaf
        self.defined = False

    def measure(self) -> Measured:
        return Measured(time.monotonic_ns(), self.q, self.enabled)

    def homed(self) -> bool:
        return self.defined

    def define(self, q: Floats) -> None:
        self.q, self.defined = self.q if self.deaf else q, True


def plant_of(arm: Arm) -> HeartbeatPlant:
    clock: Any = RecordingClock(WallClock())
    nothing: Any = None
    return HeartbeatPlant(arm, nothing, clock, nothing, nothing)  # type: ignore[arg-type]


def at_hand(terminal: Answered) -> AttendedTerminal:
    return AttendedTerminal(terminal)  # type: ignore[arg-type]


def asked_for_leave(monkeypatch: pytest.MonkeyPatch, terminal: Answered) -> None:
    monkeypatch.setattr(hardware_prompts, "Terminal", lambda told_to_end: terminal)
    try:
        confirm_enable(HardwarePreparation(LAB, "It moves."), plant_of(Arm()))
    finally:
        assert terminal.closed


def test_a_fresh_word_gives_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Answered("enable")
    asked_for_leave(monkeypatch, terminal)
    told, asked = terminal.said
    assert told == f"The arm stands at {STANDS}. It moves." and asked.endswith(WORD)


def test_a_word_that_nobody_read_for_a_while_gives_none_and_is_asked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = Answered(("enable", MAX_ANSWER_AGE_NS + 1), "enable")
    asked_for_leave(monkeypatch, terminal)
    assert [one.endswith(WORD) for one in terminal.said] == [False, True, False, True]
    with pytest.raises(Stopped):
        asked_for_leave(monkeypatch, Answered(("enable", MAX_ANSWER_AGE_NS + 1), "no"))


@pytest.mark.parametrize("answer", ["enable please", "", "Enable", "y"])
def test_another_answer_ends_it(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Stopped, match="nothing was switched on: the answer was not enable"):
        asked_for_leave(monkeypatch, Answered(answer))


def test_joints_are_typed_until_they_are_good_and_the_person_agrees() -> None:
    refused = "", "1 2", "0.5 nan 100", "0.5 0.1 100 7", "0.5 0.1 1e9"
    terminal, arm = Answered(*refused, "0.5, 0.1, 100", "no", "0.5 0.1 101", ""), Arm()
    define(at_hand(terminal), plant_of(arm), LAB)
    terminal.close()
    assert arm.q.tolist() == [0.5, 0.1, 101.0]
    asked = terminal.said[1:]
    for words in asked[1 : 2 * len(refused) : 2]:
        assert words.startswith("the joints must be ")
    asked = asked[2 * len(refused) :]
    assert [one.rpartition(". ")[0] for one in asked[1::2]] == [
        "The arm stands at theta 0.5 rad, phi 0.1 rad, rho 100 mm",
        "The arm stands at theta 0.5 rad, phi 0.1 rad, rho 101 mm",
    ]
    assert all(one.endswith(JOINTS) for one in asked[::2])
    assert all(one.endswith(SO) for one in asked[1::2])


def test_an_arm_that_does_not_take_what_it_is_told_is_not_used() -> None:
    terminal = Answered("0.5 0.1 100", "")
    with pytest.raises(NotReady, match=f"elsewhere than it was told, at {STANDS}"):
        define(at_hand(terminal), plant_of(Arm(deaf=True)), LAB)


def test_nobody_is_sent_to_move_an_arm_by_hand_whose_drive_is_on() -> None:
    terminal = Answered()
    with pytest.raises(NotReady, match="drive is on, by somebody else: switch it off there first"):
        teach_by_hand(at_hand(terminal), plant_of(Arm(enabled=True)), 5)
    assert not terminal.said


@pytest.fixture
def taught(monkeypatch: pytest.MonkeyPatch) -> Target:
    """What the camera sees when the target is taught, in pictures of 320x240."""
    target = Target(np.array([[100.0, 100.0], [120.0, 150.0]]), np.array([0.5, 0.1, 100.0]))
    monkeypatch.setattr(hardware_prompts, "teach", lambda plant, frames: target)
    monkeypatch.setattr(
        hardware_prompts, "target_setup", lambda lab, plant: target_setup_for_size(lab, 320, 240)
    )
    return target


def prepared(
    monkeypatch: pytest.MonkeyPatch, terminal: Answered, arm: Arm, **files: Path
) -> Target:
    monkeypatch.setattr(hardware_prompts, "Terminal", lambda told_to_end: terminal)
    return obtain_target(HardwarePreparation(LAB, "It moves.", **files), plant_of(arm))


ANSWERS = {JOINTS: "0.5 0.1 100", SO: "", TARGET: "", START: ""}


@pytest.mark.parametrize("last", list(ANSWERS))
def test_an_operator_can_end_it_at_every_question(
    last: str, taught: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = list(ANSWERS).index(last)
    terminal, arm = Answered(*list(ANSWERS.values())[:before]), Arm()
    with pytest.raises(Stopped):
        prepared(monkeypatch, terminal, arm, save_target=tmp_path / "target.json")
    assert terminal.said[-1].endswith(last) and terminal.closed
    assert arm.defined == (last not in (JOINTS, SO))
    assert (tmp_path / "target.json").exists() == (last == START)


def test_a_target_that_was_shown_is_kept_and_read_again_without_showing(
    taught: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "target.json"
    assert prepared(monkeypatch, Answered(*ANSWERS.values()), Arm(), save_target=file) is taught
    again = Answered(ANSWERS[JOINTS], ANSWERS[SO], ANSWERS[START])
    assert prepared(monkeypatch, again, Arm(), target=file).q.tolist() == taught.q.tolist()
    assert not any(TARGET in one for one in again.said)


def test_a_target_of_another_rig_is_refused_before_anything_is_asked(
    taught: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, terminal = tmp_path / "target.json", Answered()
    save(file, taught, replace(target_setup_for_size(LAB, 320, 240), tool=RigidTool(spacing=31.0)))
    with pytest.raises(UnusableFile, match=r"was taught with tool\.spacing 31"):
        prepared(monkeypatch, terminal, Arm(), target=file)
    assert not terminal.said
