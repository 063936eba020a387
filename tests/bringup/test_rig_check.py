"""`rig check` in a simulated laboratory: every error of the rig file is found, by small motions."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from rig_check_lab import COUNTS, MAX_TRAVEL_MM, MISTAKES, FaultyLab, Mistake

from conftest import mark_others_slow
from rcmservo.bringup.check import CheckReport
from rcmservo.bringup.findings import CheckAborted
from rcmservo.bringup.motion import SPEED_SCALE
from rcmservo.bringup.motion_escalation import MotionEscalation
from rcmservo.bringup.observations import PixelBound
from rcmservo.interfaces import ArmMeasurement, Command, Floats, Frame

CASES = [
    ("axes 1 and 2 swapped", 1),
    ("nothing", 0),
    ("both angles reversed", 6),
    ("axes 2 and 3 swapped", 1),
    ("counts of 2 in inches", 1),
    ("counts of 3 halved", 1),
]
"""Mistakes and seeds. Other tests of this folder check single reversed joints, a mirrored image,
an erroneous zero and an erroneous spacing; benchmarks/rig_check.py checks all mistakes. With seed 6
the image decides after few motions."""
CLEAR = [(1, []), (0, ["arm.counts[1]", "mechanism.insertion_zero"])]
"""Seeds, and the settings that the image leaves unclear."""


@cache
def checked(mistake: Mistake, seed: int) -> tuple[FaultyLab, CheckReport]:
    """Return a laboratory with a mistake, and the report of its check."""
    lab = FaultyLab(mistake, seed)
    return lab, lab.check()


def settings_of(report: CheckReport) -> list[str]:
    return [finding.where for finding in report.findings]


def assert_slow_and_off(lab: FaultyLab) -> None:
    """Assert that no command exceeded the speed of the check and that the drive is off."""
    assert lab.arm.commands[-1].enabled is False
    assert not lab.arm.measure().enabled
    rates = np.abs([command.rates for command in lab.arm.commands]).max(axis=0)
    assert (rates <= SPEED_SCALE * np.array(lab.gate.speed) * (1.0 + 1e-9)).all()


@pytest.mark.parametrize(
    "case", mark_others_slow(CASES), ids=lambda case: "{}, seed {}".format(*case)
)
def test_a_mistake_is_found_with_its_line_before_the_tool_travels_2_mm(
    case: tuple[str, int],
) -> None:
    name, seed = case
    mistake = MISTAKES[name]
    lab, report = checked(mistake, seed)
    assert lab.arm.max_travel < MAX_TRAVEL_MM
    assert_slow_and_off(lab)
    assert mistake.is_found(report), report.findings
    assert report.ok == (not mistake.where)
    line = line_of(mistake)
    assert not line or line in [finding.line for finding in report.findings]


@pytest.mark.slow
def test_a_first_motion_much_larger_than_predicted_returns_at_once() -> None:
    coarse = (50000.0, 50000.0, 20.0)
    lab = FaultyLab(Mistake("arm.counts[2]", (1.0, 1.0, 1000.0), counts=coarse), seed=0)
    report = lab.check()
    assert lab.arm.max_travel < MAX_TRAVEL_MM
    assert "counts = [50000.0, 50000.0, 20.0]" in [finding.line for finding in report.findings]
    assert_slow_and_off(lab)


@pytest.mark.slow
def test_an_arm_with_usual_encoders_needs_at_most_20_motions() -> None:
    lab, report = checked(Mistake(), 1)
    assert report.ok
    assert len([line for line in lab.operator.questions if line.startswith("Move")]) <= 20


@pytest.mark.slow
def test_an_error_of_the_zero_above_the_documented_limit_is_found() -> None:
    mistake = Mistake("mechanism.insertion_zero", zero=-8.0)
    lab = FaultyLab(mistake, seed=6)
    assert mistake.is_found(lab.check())
    assert lab.arm.max_travel < MAX_TRAVEL_MM


@pytest.mark.slow
def test_an_unknown_length_leaves_two_possibilities_with_all_their_findings() -> None:
    lab = FaultyLab(Mistake(factors=(-1.0, 1.0, 1.0), spacing=1.25), seed=1)
    lab.operator.override = lambda line: "unknown" if "how far apart" in line else None
    report = lab.check()
    found = {(one.what.split(":")[0], one.where) for one in report.findings}
    one, other = "possibility 1 of 2", "possibility 2 of 2"
    reversed_, spacing, counts = "arm.counts[0]", "tool.spacing", "arm.counts[2]"
    assert found == {(one, reversed_), (one, spacing), (other, reversed_), (other, counts)}
    assert not report.ok


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "unclear"), CLEAR)
def test_settings_that_the_image_leaves_unclear_are_reported(seed: int, unclear: list[str]) -> None:
    lab, report = checked(Mistake(), seed)
    assert report.ok
    assert [words.split()[0] for words in report.unclear] == unclear
    advice = [words for words in lab.operator.messages if words.endswith("Measure it by hand.")]
    assert len(advice) == len(unclear)


def line_of(mistake: Mistake) -> str:
    """Return the expected line of the rig file, if it does not depend on a measured value."""
    if mistake.where.startswith("arm.counts"):
        return f"counts = [{', '.join(map(repr, COUNTS))}]"
    return 'axes = "ABC"' if mistake.where == "arm.axes" else ""


@pytest.mark.slow
def test_each_motion_needs_agreement_and_is_at_most_twice_the_last_one() -> None:
    mistake = Mistake("camera", mirrored=True)
    lab = FaultyLab(mistake, seed=1)
    enable, agreed = lab.arm.enable, list[str]()

    def noted() -> None:
        agreed.append(lab.operator.questions[-1])
        enable()

    lab.arm.enable = noted  # type: ignore[method-assign]
    report = lab.check()
    assert mistake.is_found(report), report.findings
    assert lab.arm.max_travel < MAX_TRAVEL_MM
    assert any("in which direction" in line for line in lab.operator.questions)
    assert agreed == [line for line in lab.operator.questions if line.startswith("Move joint")]
    for joint in (1, 2, 3):
        motions = [int(words.split(" counts")[0].split()[-1]) for words in agreed]
        pairs = zip(motions, agreed, strict=True)
        of_joint = [motion for motion, question in pairs if f"joint {joint}" in question]
        assert all(new <= 2 * old + 1 for old, new in pairwise(of_joint))


def decide_after_one_motion_of_each_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the check where a test does not depend on what its motions identify."""
    monkeypatch.setattr(MotionEscalation, "_double_small_motions", lambda _: np.zeros(3))
    monkeypatch.setattr(MotionEscalation, "_is_decided", lambda _: True)


@pytest.mark.slow
def test_the_operator_may_refuse_a_motion_to_watch(monkeypatch: pytest.MonkeyPatch) -> None:
    decide_after_one_motion_of_each_joint(monkeypatch)
    lab = FaultyLab(Mistake(), seed=1)

    def no(line: str) -> str | None:
        watching = lab.operator.messages[-1].startswith("Watch the tool")
        return "no" if watching and line.startswith("Move") else None

    lab.operator.override = no
    report = lab.check()
    assert settings_of(report) == ["operator"]
    assert not any("in which direction" in line for line in lab.operator.questions)


REFUSALS = [
    ("May the drive", "no"),
    ("May the drive", "stop"),
    ("May the drive", "what?"),
    ("Move joint 1", "what?"),
    ("Move joint 3", "stop"),
    pytest.param("in alternating directions", "no", marks=pytest.mark.slow),
]
"""Questions for agreement, each kind of refusal, and the first question with all of them."""


@pytest.mark.parametrize(("question", "answer"), REFUSALS)
def test_nothing_moves_after_the_operator_refuses(
    question: str, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    decide_after_one_motion_of_each_joint(monkeypatch)
    lab = FaultyLab(Mistake(), seed=1)
    commands: list[int] = []

    def instead(line: str) -> str | None:
        if question not in line:
            return None
        commands.append(len(lab.arm.commands))
        return answer

    lab.operator.override = instead
    report = lab.check()
    assert commands and "operator" in settings_of(report)
    assert not report.ok
    after = lab.arm.commands[commands[0] :]
    assert not any(command.enabled for command in after)
    assert not lab.arm.measure().enabled


@pytest.mark.parametrize("moment", [1, 60, 200])
def test_ctrl_c_in_a_motion_switches_the_drive_off_and_ends_the_check(moment: int) -> None:
    lab = FaultyLab(Mistake(), seed=1)
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


def failing(kind: str, lab: FaultyLab, after: int) -> None:
    """Inject a fault into the arm, from its answer number `after` with the drive on."""
    measure, answers = lab.arm.measure, [0]
    last: list[ArmMeasurement] = []

    def faulty() -> ArmMeasurement:
        now = measure()
        answers[0] += now.enabled
        if answers[0] < after:
            last[:] = [now]
            return now
        match kind:
            case "off":
                lab.arm.off_reason = "axis B: following error"
                return now._replace(enabled=False)
            case "silent":
                return last[0]
            case "dead encoder":
                return now._replace(q=last[0].q.copy())
            case _:
                return now._replace(q=lab.arm.mark + (now.q - lab.arm.mark)[[1, 0, 2]])

    lab.arm.measure = faulty  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("off", "axis B: following error"),
        ("silent", "no answer"),
        ("dead encoder", "counts of joints"),
        ("crossed encoders", "counts of joints"),
    ],
)
def test_a_fault_ends_the_check_and_the_drive_stays_off(kind: str, words: str) -> None:
    lab = FaultyLab(Mistake(), seed=1)
    failing(kind, lab, 200)
    enabled = lambda: lab.arm.enabled  # noqa: E731
    report = lab.check()
    assert words in report.findings[-1].found
    assert not lab.rig.arm.measure().enabled
    assert lab.arm.commands[-1].enabled is False
    assert enabled() <= 3
    assert lab.arm.max_travel < 0.5


UNBOUNDED = PixelBound(np.zeros((2, 2)), np.inf)


def test_a_motion_during_averaging_ends_the_check() -> None:
    """Joint 1 creeps after joint 3 has arrived."""
    lab = FaultyLab(Mistake(), seed=1)
    measure, apply, at_rest = lab.arm.measure, lab.arm.apply, [0]

    def counted(command: Command) -> Floats:
        at_rest[0] += command.enabled and bool((np.abs(command.rates) < 1e-2).all())
        return apply(command)

    def faulty() -> ArmMeasurement:
        now = measure()
        creeping = np.array([2e-5, 0.0, 0.0]) * max(at_rest[0] - 50, 0)
        return now._replace(q=now.q + creeping)

    lab.arm.apply, lab.arm.measure = counted, faulty  # type: ignore[method-assign]
    with pytest.raises(CheckAborted) as ended:
        lab.mover.visit(2, (0.2,), UNBOUNDED)
    assert "another joint counts" in ended.value.finding.what
    assert lab.arm.q_true[2] > lab.arm.mark[2] + 0.1  # no return
    assert not lab.arm.measure().enabled


def test_a_joint_that_friction_stops_near_its_goal_counts_as_arrived() -> None:
    lab = FaultyLab(Mistake(), seed=1)
    apply, sent = lab.arm.apply, list[Floats]()

    def stuck(command: Command) -> Floats:
        sent.append(command.rates)
        held = lab.arm.q_true[2] > lab.arm.mark[2] + 0.8 and command.rates[2] > 0.0
        return apply(replace(command, rates=command.rates * [1.0, 1.0, 0.0]) if held else command)

    lab.arm.apply = stuck  # type: ignore[method-assign]
    lab.mover.visit(2, (1.0,), UNBOUNDED)
    last = max(k for k, rates in enumerate(sent) if rates[2] > 0.0)
    assert last < 250
    assert not any(rates.any() for rates in sent[last + 1 : last + 100])


@pytest.mark.parametrize("lost", ["markers", "frames"])
def test_missing_markers_or_frames_end_the_check(lost: str) -> None:
    frames: list[Frame] = []

    def change(frame: Frame) -> Frame | None:
        frames.append(frame)
        if len(frames) < 200:
            return frame
        return None if lost == "frames" else replace(frame, points=np.full((2, 2), np.nan))

    lab = FaultyLab(Mistake(), seed=1, change=change)
    report = lab.check()
    assert settings_of(report) == ["camera" if lost == "frames" else "markers"]
    assert not lab.arm.measure().enabled
    assert lab.arm.max_travel < 0.5


def test_an_arm_that_is_not_homed_does_not_move() -> None:
    lab = FaultyLab(Mistake(), seed=1)
    lab.arm.known = False
    assert settings_of(lab.check()) == ["arm"]
    assert lab.arm.enabled == 0
    assert not lab.operator.questions


def test_a_joint_at_its_limit_is_reported_before_any_motion() -> None:
    lab = FaultyLab(Mistake(), seed=1)
    limits = lab.robot.mechanism.limits
    q = np.array([0.0, 0.0, limits.upper[2] - 1.0])
    at_limit = lambda: lab.rig.arm.measure()._replace(q=q.copy())  # noqa: E731
    lab.arm.measure = at_limit  # type: ignore[method-assign]
    report = lab.check()
    assert settings_of(report) == ["mechanism.upper[2]"]
    assert lab.arm.enabled == 0
