"""Questions to the operator at the arm, with scripted answers and a simple arm.

`test_terminal_operator.py` tests the terminal itself.
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
    define_joints,
    describe_target_setup,
    obtain_target,
    teach_by_hand,
)
from rcmservo.config.rig_file import RigDescription
from rcmservo.config.target_file import save_target
from rcmservo.errors import Stopped, UnusableFile
from rcmservo.geometry.tool import RigidTool
from rcmservo.interfaces import ArmMeasurement, Floats, Target
from rcmservo.live.device_protocols import NotReady
from rcmservo.live.servo_process import HeartbeatPlant
from rcmservo.loop.clock import RecordingClock, WallClock

WORD, JOINTS, CONFIRM = "ends the program:", "0.1 -0.2 100:", "Press Enter to confirm:"
TARGET, START = (
    "to the target by hand, then press Enter:",
    "to its start by hand, then press Enter:",
)
LAB = RigDescription(devices={"camera": {"kind": "opencv", "source": "0"}})
INITIAL_JOINTS = "theta 0.6 rad, phi 0.2 rad, rho 120 mm"


class ScriptedTerminal:
    """Terminal with scripted answers.

    Each answer has its words and its smallest age in ns. After the last answer the terminal ends as
    after Ctrl-D.
    """

    def __init__(self, *answers: str | tuple[str, int]) -> None:
        self._answers = [(answer, 0) if isinstance(answer, str) else answer for answer in answers]
        self.typed, self.closed = 0, False
        self.printed: list[str] = []

    def notify(self, message: str) -> None:
        self.printed.append(message)

    def ask(self, question: str) -> str:
        self.printed.append(question)
        if not self._answers:
            raise Stopped("stopped at the terminal before the drive was on")
        words, age = self._answers.pop(0)
        self.typed = time.monotonic_ns() - age
        return words.strip()

    def close(self) -> None:
        assert not self._answers, "some questions did not occur"
        self.closed = True


class Arm:
    def __init__(self, enabled: bool = False, ignores_define: bool = False) -> None:
        self.q, self.enabled, self.ignores_define = (
            np.array([0.6, 0.2, 120.0]),
            enabled,
            ignores_define,
        )
        self.defined = False

    def measure(self) -> ArmMeasurement:
        return ArmMeasurement(time.monotonic_ns(), self.q, self.enabled)

    def is_homed(self) -> bool:
        return self.defined

    def set_position(self, q: Floats) -> None:
        self.q, self.defined = self.q if self.ignores_define else q, True


def plant_of(arm: Arm) -> HeartbeatPlant:
    clock: Any = RecordingClock(WallClock())
    nothing: Any = None
    return HeartbeatPlant(arm, nothing, clock, nothing, nothing)  # type: ignore[arg-type]


def attended(terminal: ScriptedTerminal) -> AttendedTerminal:
    return AttendedTerminal(terminal)  # type: ignore[arg-type]


def confirm_enable_at(monkeypatch: pytest.MonkeyPatch, terminal: ScriptedTerminal) -> None:
    monkeypatch.setattr(hardware_prompts, "Terminal", lambda told_to_end: terminal)
    try:
        confirm_enable(HardwarePreparation(LAB, "It moves."), plant_of(Arm()))
    finally:
        assert terminal.closed


def test_a_word_typed_after_the_question_confirms_the_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = ScriptedTerminal("enable")
    confirm_enable_at(monkeypatch, terminal)
    announcement, question = terminal.printed
    assert announcement == f"The arm is at {INITIAL_JOINTS}. It moves." and question.endswith(WORD)


def test_a_word_typed_before_the_question_does_not_confirm_and_is_requested_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = ScriptedTerminal(("enable", MAX_ANSWER_AGE_NS + 1), "enable")
    confirm_enable_at(monkeypatch, terminal)
    assert [line.endswith(WORD) for line in terminal.printed] == [False, True, False, True]
    with pytest.raises(Stopped):
        confirm_enable_at(monkeypatch, ScriptedTerminal(("enable", MAX_ANSWER_AGE_NS + 1), "no"))


@pytest.mark.parametrize("answer", ["enable please", "", "Enable", "y"])
def test_any_other_answer_ends_the_program(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Stopped, match="the drive was not switched on: the answer was not enable"):
        confirm_enable_at(monkeypatch, ScriptedTerminal(answer))


def test_joints_are_requested_until_they_are_valid_and_confirmed() -> None:
    refused = "", "1 2", "0.5 nan 100", "0.5 0.1 100 7", "0.5 0.1 1e9"
    terminal, arm = ScriptedTerminal(*refused, "0.5, 0.1, 100", "no", "0.5 0.1 101", ""), Arm()
    define_joints(attended(terminal), plant_of(arm), LAB)
    terminal.close()
    assert arm.q.tolist() == [0.5, 0.1, 101.0]
    output = terminal.printed[1:]
    for message in output[1 : 2 * len(refused) : 2]:
        assert message.startswith("the joints must be ")
    output = output[2 * len(refused) :]
    assert [line.rpartition(". ")[0] for line in output[1::2]] == [
        "The arm is at theta 0.5 rad, phi 0.1 rad, rho 100 mm",
        "The arm is at theta 0.5 rad, phi 0.1 rad, rho 101 mm",
    ]
    assert all(line.endswith(JOINTS) for line in output[::2])
    assert all(line.endswith(CONFIRM) for line in output[1::2])


def test_an_arm_that_does_not_take_the_defined_joints_is_not_used() -> None:
    terminal = ScriptedTerminal("0.5 0.1 100", "")
    with pytest.raises(
        NotReady, match=f"did not take the defined joint values; it reports {INITIAL_JOINTS}"
    ):
        define_joints(attended(terminal), plant_of(Arm(ignores_define=True)), LAB)


def test_moving_by_hand_is_not_requested_while_the_drive_is_on() -> None:
    terminal = ScriptedTerminal()
    with pytest.raises(
        NotReady, match="has switched the arm's drive on: switch it off there first"
    ):
        teach_by_hand(attended(terminal), plant_of(Arm(enabled=True)), 5)
    assert not terminal.printed


@pytest.fixture
def taught(monkeypatch: pytest.MonkeyPatch) -> Target:
    """Replace teaching by a fixed target in images of 320x240."""
    target = Target(np.array([[100.0, 100.0], [120.0, 150.0]]), np.array([0.5, 0.1, 100.0]))
    monkeypatch.setattr(hardware_prompts, "teach", lambda plant, frames: target)
    monkeypatch.setattr(
        hardware_prompts, "target_setup", lambda lab, plant: describe_target_setup(lab, 320, 240)
    )
    return target


def prepare(
    monkeypatch: pytest.MonkeyPatch, terminal: ScriptedTerminal, arm: Arm, **files: Path
) -> Target:
    monkeypatch.setattr(hardware_prompts, "Terminal", lambda told_to_end: terminal)
    return obtain_target(HardwarePreparation(LAB, "It moves.", **files), plant_of(arm))


ANSWERS = {JOINTS: "0.5 0.1 100", CONFIRM: "", TARGET: "", START: ""}


@pytest.mark.parametrize("last", list(ANSWERS))
def test_the_operator_can_end_the_program_at_every_question(
    last: str, taught: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = list(ANSWERS).index(last)
    terminal, arm = ScriptedTerminal(*list(ANSWERS.values())[:before]), Arm()
    with pytest.raises(Stopped):
        prepare(monkeypatch, terminal, arm, save_target=tmp_path / "target.json")
    assert terminal.printed[-1].endswith(last) and terminal.closed
    assert arm.defined == (last not in (JOINTS, CONFIRM))
    assert (tmp_path / "target.json").exists() == (last == START)


def test_a_taught_target_is_saved_and_read_without_teaching(
    taught: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "target.json"
    assert (
        prepare(monkeypatch, ScriptedTerminal(*ANSWERS.values()), Arm(), save_target=file) is taught
    )
    second = ScriptedTerminal(ANSWERS[JOINTS], ANSWERS[CONFIRM], ANSWERS[START])
    assert prepare(monkeypatch, second, Arm(), target=file).q.tolist() == taught.q.tolist()
    assert not any(TARGET in line for line in second.printed)


def test_a_target_of_another_rig_is_refused_before_any_question(
    taught: Target, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, terminal = tmp_path / "target.json", ScriptedTerminal()
    save_target(
        file, taught, replace(describe_target_setup(LAB, 320, 240), tool=RigidTool(spacing=31.0))
    )
    with pytest.raises(UnusableFile, match=r"was taught with tool\.spacing 31"):
        prepare(monkeypatch, terminal, Arm(), target=file)
    assert not terminal.printed
