"""`rig check` in a simulated lab: every mistake is named, and nothing moves far or unasked."""

from dataclasses import replace
from functools import cache
from itertools import cycle, pairwise
from typing import Any

import numpy as np
import pytest
from rig_check_lab import COUNTS, MISTAKES, Mistake, WrongLab

from conftest import first_quick
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.findings import CheckAborted
from rcmservo.bringup.motion import SPEED_SCALE
from rcmservo.bringup.observations import PixelBound
from rcmservo.interfaces import Command, Floats, Frame, Measured

QUICK = "axes 1 and 2 swapped", 1
CASES = [QUICK, *(case for case in zip(MISTAKES, cycle([0, 1]), strict=False) if case != QUICK)]
"""Mistakes and seeds."""
CLEAR = [(1, []), (0, ["arm.counts[1]"])]
"""Seeds, and what the picture does not tell well enough."""

FAR = 2.0
"""mm that marker 2 may go at most before the mistake is named."""


@cache
def sound(seed: int) -> tuple[WrongLab, CheckReport]:
    """A lab without a mistake, and the report of its check."""
    lab = WrongLab(Mistake(), seed)
    return lab, lab.check()


def wheres(report: CheckReport) -> list[str]:
    return [finding.where for finding in report.findings]


def quiet(lab: WrongLab) -> None:
    """The drive is off at the end, and no command was beyond the share of the speed."""
    assert lab.arm.commands[-1].enabled is False
    assert not lab.arm.measure().enabled
    rates = np.abs([command.rates for command in lab.arm.commands]).max(axis=0)
    assert (rates <= SPEED_SCALE * np.array(lab.gate.speed) * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("case", first_quick(CASES), ids=lambda case: "{}, seed {}".format(*case))
def test_a_mistake_is_named_with_its_line_before_the_tool_has_gone_2_mm(
    case: tuple[str, int],
) -> None:
    name, seed = case
    mistake = MISTAKES[name]
    lab = WrongLab(mistake, seed)
    report = lab.check()
    assert lab.arm.farthest < FAR
    quiet(lab)
    assert mistake.named(report), report.findings
    assert report.ok == (not mistake.where)
    right = line_of(mistake)
    assert not right or right in [finding.line for finding in report.findings]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_first_motion_that_shows_many_times_what_the_file_says_ends_there(seed: int) -> None:
    coarse = (50000.0, 50000.0, 20.0)
    lab = WrongLab(Mistake("arm.counts[2]", (1.0, 1.0, 1000.0), counts=coarse), seed)
    report = lab.check()
    assert lab.arm.farthest < FAR
    assert "counts = [50000.0, 50000.0, 20.0]" in [finding.line for finding in report.findings]
    quiet(lab)


@pytest.mark.slow
def test_an_arm_with_usual_encoders_is_checked_by_as_few_motions_as_ever() -> None:
    lab, report = sound(1)
    assert report.ok
    assert len([asked for asked in lab.person.asked if asked.startswith("Move")]) <= 20


@pytest.mark.slow
@pytest.mark.parametrize("by", [8.0, -8.0])
def test_a_zero_that_is_wrong_by_more_than_is_promised_is_named(by: float) -> None:
    mistake = Mistake("mechanism.insertion_zero", zero=by)
    lab = WrongLab(mistake, seed=2)
    assert mistake.named(lab.check())
    assert lab.arm.farthest < FAR


@pytest.mark.slow
def test_what_nobody_can_measure_is_told_as_one_of_several() -> None:
    """With all that is wrong beside it."""
    lab = WrongLab(Mistake(factors=(-1.0, 1.0, 1.0), spacing=1.25), seed=1)
    lab.person.instead = lambda asked: "unknown" if "how far apart" in asked else None
    report = lab.check()
    told = {(one.what.split(":")[0], one.where) for one in report.findings}
    one, other = "possibility 1 of 2", "possibility 2 of 2"
    reversed_, spacing, counts = "arm.counts[0]", "tool.spacing", "arm.counts[2]"
    assert told == {(one, reversed_), (one, spacing), (other, reversed_), (other, counts)}
    assert not report.ok


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "unclear"), CLEAR)
def test_what_the_picture_does_not_tell_well_enough_is_said(seed: int, unclear: list[str]) -> None:
    lab, report = sound(seed)
    assert report.ok
    assert [words.split()[0] for words in report.unclear] == unclear
    told = [words for words in lab.person.told if words.endswith("measure it by hand.")]
    assert len(told) == len(unclear)


def line_of(mistake: Mistake) -> str:
    """The line of the rig file that must be told, where it does not depend on what was measured."""
    if mistake.where.startswith("arm.counts"):
        return f"counts = [{', '.join(map(repr, COUNTS))}]"
    return 'axes = "ABC"' if mistake.where == "arm.axes" else ""


def test_the_drive_comes_on_only_after_a_yes_to_at_most_twice_the_last_way() -> None:
    lab = WrongLab(Mistake(mirrored=True), seed=1)
    enable, agreed = lab.arm.enable, list[str]()

    def noted() -> None:
        agreed.append(lab.person.asked[-1])
        enable()

    lab.arm.enable = noted  # type: ignore[method-assign]
    lab.check()
    assert any("which way" in asked for asked in lab.person.asked)
    assert agreed == [asked for asked in lab.person.asked if asked.startswith("Move joint")]
    for joint in (1, 2, 3):
        ways = [int(words.split(" counts")[0].split()[-1]) for words in agreed]
        its = [w for w, asked in zip(ways, agreed, strict=True) if f"joint {joint}" in asked]
        assert all(new <= 2 * old + 1 for old, new in pairwise(its))


@pytest.mark.slow
def test_a_motion_that_is_to_be_watched_may_be_refused() -> None:
    lab = WrongLab(Mistake(), seed=1)

    def no(asked: str) -> str | None:
        watching = lab.person.told[-1].startswith("Watch the tool")
        return "no" if watching and asked.startswith("Move") else None

    lab.person.instead = no
    report = lab.check()
    assert wheres(report) == ["person"]
    assert not any("which way" in asked for asked in lab.person.asked)


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
    assert not any(command.enabled for command in after)
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
    """From its so-many-th answer with the drive on, something is wrong with the arm."""
    measure, answers = lab.arm.measure, [0]
    last: list[Measured] = []

    def told() -> Measured:
        now = measure()
        answers[0] += now.enabled
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
    failing(kind, lab, 200)
    enabled = lambda: lab.arm.enabled  # noqa: E731
    report = lab.check()
    assert words in report.findings[-1].found
    assert not lab.rig.arm.measure().enabled
    assert lab.arm.commands[-1].enabled is False
    assert enabled() <= 3
    assert lab.arm.farthest < 0.5


def home_of(lab: WrongLab) -> PixelBound:
    return PixelBound(np.zeros((2, 2)), np.inf)


def test_what_moves_while_the_picture_is_averaged_ends_it_too() -> None:
    """Joint 1 counts, mm for mm, once joint 3 is at its place."""
    lab = WrongLab(Mistake(), seed=1)
    measure, apply, at_rest = lab.arm.measure, lab.arm.apply, [0]

    def noted(command: Command) -> Floats:
        at_rest[0] += command.enabled and bool((np.abs(command.rates) < 1e-2).all())
        return apply(command)

    def told() -> Measured:
        now = measure()
        creeping = np.array([2e-5, 0.0, 0.0]) * max(at_rest[0] - 50, 0)
        return now._replace(q=now.q + creeping)

    lab.arm.apply, lab.arm.measure = noted, told  # type: ignore[method-assign]
    with pytest.raises(CheckAborted) as ended:
        lab.mover.visit(2, (0.2,), home_of(lab))
    assert "another joint counts" in ended.value.finding.what
    assert lab.arm.q_true[2] > lab.arm.mark[2] + 0.1  # it never went back
    assert not lab.arm.measure().enabled


def test_at_its_place_a_joint_is_sent_nothing_though_friction_keeps_it_from_all_of_its_way() -> (
    None
):
    lab = WrongLab(Mistake(), seed=1)
    apply, sent = lab.arm.apply, list[Floats]()

    def stuck(command: Command) -> Floats:
        sent.append(command.rates)
        held = lab.arm.q_true[2] > lab.arm.mark[2] + 0.8 and command.rates[2] > 0.0
        return apply(replace(command, rates=command.rates * [1.0, 1.0, 0.0]) if held else command)

    lab.arm.apply = stuck  # type: ignore[method-assign]
    lab.mover.visit(2, (1.0,), home_of(lab))
    last = max(k for k, rates in enumerate(sent) if rates[2] > 0.0)
    assert last < 250
    assert not any(rates.any() for rates in sent[last + 1 : last + 100])


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
    at_limit = lambda: lab.rig.arm.measure()._replace(q=q.copy())  # noqa: E731
    lab.arm.measure = at_limit  # type: ignore[method-assign]
    report = lab.check()
    assert wheres(report) == ["mechanism.upper[2]"]
    assert lab.arm.enabled == 0
