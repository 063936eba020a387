"""`rig check` in a simulated lab: every mistake is named, and nothing moves far or unasked."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rig_check_lab import COUNTS, MISTAKES, Mistake, WrongLab

from conftest import first_quick
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.motion import SHARE
from rcmservo.interfaces import Frame, Measured

FAR = 2.0
"""mm that marker 2 may go at most before the mistake is named."""


def wheres(report: CheckReport) -> list[str]:
    return [finding.where for finding in report.findings]


def quiet(lab: WrongLab) -> None:
    """The drive is off at the end, and no command was beyond the share of the speed."""
    assert lab.arm.commands[-1].enabled is False
    assert not lab.arm.measure().enabled
    rates = np.abs([command.rates for command in lab.arm.commands]).max(axis=0)
    assert (rates <= SHARE * np.array(lab.gate.speed) * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("name", first_quick(["axes 1 and 2 swapped", *MISTAKES]))
@pytest.mark.parametrize("seed", first_quick([1, 0]))
def test_a_mistake_is_named_with_its_line_before_the_tool_has_gone_2_mm(
    name: str, seed: int
) -> None:
    mistake = MISTAKES[name]
    lab = WrongLab(mistake, seed)
    report = lab.check()
    assert lab.arm.farthest < FAR
    quiet(lab)
    assert report.done
    assert report.ok == (not mistake.where)
    if mistake.where:
        assert mistake.where in wheres(report)
    right = line_of(mistake)
    assert not right or right in [finding.line for finding in report.findings]


def line_of(mistake: Mistake) -> str:
    """The line of the rig file that must be told, where it does not depend on what was measured."""
    if mistake.where.startswith("arm.counts"):
        return f"counts = [{', '.join(map(repr, COUNTS))}]"
    return 'axes = "ABC"' if mistake.where == "arm.axes" else ""


def test_latency_and_lag_are_those_of_the_camera_and_the_drives() -> None:
    lab = WrongLab(Mistake(), seed=1)
    lab.latency = 0.0
    report = lab.check()
    assert report.lateness is not None
    assert abs(report.lateness.latency - 0.022) < 4.0 * report.lateness.within < 0.01
    assert abs(report.lag - 0.024) < 0.01
    assert wheres(report) == ["camera.latency"]
    assert not report.ok


ENDS = ["May the drive", "Move joint 1", "Move joint 3", "to and fro", "which way"]


@pytest.mark.parametrize(
    "question", ENDS[:3] + [pytest.param(e, marks=pytest.mark.slow) for e in ENDS[3:]]
)
@pytest.mark.parametrize("answer", ["no", "stop", "what?"])
def test_nothing_moves_after_a_person_did_not_agree(question: str, answer: str) -> None:
    lab = WrongLab(Mistake(), seed=1)
    commands: list[int] = []

    def instead(asked: str) -> str | None:
        if question not in asked:
            return None
        commands.append(len(lab.arm.commands))
        return answer

    lab.person.instead = instead
    report = lab.check()
    assert "person" in wheres(report)
    assert not report.ok
    after = lab.arm.commands[commands[0] :]
    moving = [command for command in after if command.enabled]
    assert not moving or question == "which way"  # there a person asks to see it again
    assert not lab.arm.measure().enabled


@pytest.mark.parametrize("moment", [1, 60, 200])
def test_ctrl_c_in_a_motion_switches_the_drive_off_and_ends_it(moment: int) -> None:
    lab = WrongLab(Mistake(), seed=1)
    apply, before = lab.arm.apply, []

    def pressed(command: Any) -> Any:
        before.append(command)
        if len(before) == moment:
            raise KeyboardInterrupt
        return apply(command)

    lab.arm.apply = pressed  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        lab.check()
    assert not any(command.enabled for command in before[moment:])
    assert not lab.arm.measure().enabled


def failing(kind: str, lab: WrongLab, after: int) -> None:
    """From its so-many-th answer on, something is wrong with the arm."""
    measure, answers = lab.arm.measure, [0]
    last: list[Measured] = []

    def told() -> Measured:
        now = measure()
        answers[0] += 1
        if answers[0] < after:
            last[:] = [now]
            return now
        match kind:
            case "off":
                lab.arm.why_off = "axis B: following error"
                return now._replace(enabled=False)
            case "silent":
                return last[0]
            case "dead encoder":
                return now._replace(q=last[0].q.copy())
            case _:
                return now._replace(q=lab.arm.mark + (now.q - lab.arm.mark)[[1, 0, 2]])

    lab.arm.measure = told  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("off", "axis B: following error"),
        ("silent", "no answer"),
        ("dead encoder", "counts of joints"),
        ("crossed encoders", "counts of joints"),
    ],
)
def test_a_fault_ends_it_with_the_drive_off_for_good(kind: str, words: str) -> None:
    lab = WrongLab(Mistake(), seed=1)
    failing(kind, lab, 400)
    enabled = lambda: lab.arm.enabled  # noqa: E731
    report = lab.check()
    assert words in report.findings[-1].found
    assert not lab.rig.arm.measure().enabled
    assert lab.arm.commands[-1].enabled is False
    assert enabled() <= 3
    assert lab.arm.farthest < 0.5


@pytest.mark.parametrize("lost", ["markers", "frames"])
def test_without_markers_or_frames_nothing_goes_on(lost: str) -> None:
    seen: list[Frame] = []

    def change(frame: Frame) -> Frame | None:
        seen.append(frame)
        if len(seen) < 200:
            return frame
        return None if lost == "frames" else replace(frame, points=np.full((2, 2), np.nan))

    lab = WrongLab(Mistake(), seed=1, change=change)
    report = lab.check()
    assert wheres(report) == ["camera" if lost == "frames" else "markers"]
    assert not lab.arm.measure().enabled
    assert lab.arm.farthest < 0.5


def test_an_arm_that_does_not_know_where_it_stands_is_not_moved() -> None:
    lab = WrongLab(Mistake(), seed=1)
    lab.arm.known = False
    assert wheres(lab.check()) == ["arm"]
    assert lab.arm.enabled == 0
    assert not lab.person.asked


def test_a_joint_at_its_limit_is_told_before_anything_moves() -> None:
    lab = WrongLab(Mistake(), seed=1)
    limits = lab.robot.mechanism.limits
    q = np.array([0.0, 0.0, limits.upper[2] - 1.0])
    lab.arm.measure = lambda: lab.rig.arm.measure()._replace(q=q.copy())  # type: ignore[method-assign]
    report = lab.check()
    assert wheres(report) == ["mechanism.upper[2]"]
    assert lab.arm.enabled == 0
