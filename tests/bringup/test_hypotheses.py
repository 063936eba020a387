"""Hypotheses about errors of a rig file, and the operator's answers that decide between them."""

from dataclasses import replace

import numpy as np
import pytest

from rcmservo.bringup.axis_wiring import Robot, Wiring
from rcmservo.bringup.corrections import list_corrections
from rcmservo.bringup.hypotheses import (
    Hypothesis,
    fit_all,
    generate_equivalents,
    select_most_likely,
)
from rcmservo.bringup.identification import SPACING, ZERO, MarkerViews
from rcmservo.bringup.operator_questions import ask_operator
from rcmservo.bringup.prompts import ask_choice, require_yes
from rcmservo.errors import Stopped
from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.geometry.tool import RigidTool
from rcmservo.sim import Rig

ROBOT = Robot(SphericalRcm(), RigidTool(spacing=30.0), Wiring((5e4, 5e4, 500.0), axes="ABC"))


class PreparedOperator:
    """Operator with prepared answers."""

    def __init__(self, *answers: str) -> None:
        self.answers, self.messages = list(answers), []

    def notify(self, message: str) -> None:
        self.messages.append(message)

    def ask(self, question: str) -> str:
        return self.answers.pop(0)


def views(seed: int, hypothesis: Hypothesis) -> MarkerViews:
    """Return views of motions of each joint by ± 1 mm, with `hypothesis` true."""
    rig = Rig(seed, pictures=False)
    start = rig.scene.start
    motions = np.diag(ROBOT.compute_joint_per_mm(start))
    q = start + np.concatenate([np.zeros((1, 3)), motions, -motions])
    points = np.stack(
        [rig.scene.optics.project(two) for two in hypothesis.compute_markers(ROBOT, q)]
    )
    result = MarkerViews(q, points, np.full(len(q), 0.03), (640, 480), np.zeros_like(q))
    return result.mirrored() if hypothesis.mirrored else result


@pytest.mark.parametrize(
    "hypothesis",
    [
        Hypothesis(),
        Hypothesis(order=(1, 0, 2)),
        Hypothesis(reversed=(True, False, False)),
        Hypothesis(mirrored=True),
        Hypothesis(number=0, size=float(np.log(180.0 / np.pi))),
    ],
)
def test_the_true_hypothesis_is_equivalent_to_the_only_likely_one(hypothesis: Hypothesis) -> None:
    left = select_most_likely(fit_all(ROBOT, views(2, hypothesis)))
    assert len(left) == 1
    assert hypothesis in list(generate_equivalents(left[0]))


def test_an_image_leaves_four_combinations_of_signs_and_mirror_open() -> None:
    left = select_most_likely(fit_all(ROBOT, views(2, Hypothesis())))
    together = {(m.reversed, m.mirrored) for m in generate_equivalents(left[0])}
    assert together == {
        ((False, False, False), False),
        ((True, True, False), False),
        ((True, False, False), True),
        ((False, True, False), True),
    }


def test_exchanged_axes_keep_the_signs_of_their_counts() -> None:
    robot = replace(ROBOT, wiring=Wiring((5e4, -5e4, 500.0), axes="ABC"))
    swapped, start = Hypothesis(order=(1, 0, 2)), np.array([0.1, 0.2, 100.0])
    reported = start + np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    actual = start + np.array([[0.0, 0.0, 0.0], [0.0, -0.01, 0.0]])
    assert np.allclose(
        swapped.compute_markers(robot, reported), Hypothesis().compute_markers(robot, actual)
    )
    assert swapped.predict_moving_joint(0, robot.wiring) == (1, -1)
    assert swapped.predict_moving_joint(2, robot.wiring) == (2, 1)
    assert swapped.predict_moving_joint(0, ROBOT.wiring) == (1, 1)


def test_each_equivalent_hypothesis_reports_the_uncertainty_of_its_own_number() -> None:
    left = select_most_likely(fit_all(ROBOT, views(2, Hypothesis(number=SPACING, size=0.25))))
    for hypothesis in (member for kind in left for member in generate_equivalents(kind)):
        found = [
            one for one in list_corrections(hypothesis, ROBOT) if "%" in one.what + one.expected
        ]
        assert found
        assert not any("± 0 %" in one.what + one.expected for one in found)


def decided_by(
    *answers: str, among: list[Hypothesis], mm: float = 1.0
) -> tuple[list[Hypothesis], PreparedOperator]:
    """Return the hypotheses that remain after the operator's answers, and the operator.

    The operator answers questions about directions truthfully and other questions with `answers`.
    Motions that the operator watches move marker 2 by `mm`.
    """
    operator = PreparedOperator(*answers)
    start = np.array([0.3, 0.2, 100.0])

    def show(joint: int) -> None:
        if operator.messages[-1].startswith("Watch the tool"):
            operator.answers.insert(0, ["away", "clockwise", "in"][joint])

    def motion(joint: int) -> float:
        return mm * ROBOT.compute_joint_per_mm(start)[joint]

    return ask_operator(among, ROBOT, start, operator, show, motion), operator


APART = Hypothesis(number=SPACING, size=float(np.log(1.25)), deviation=0.01)
LONGER = Hypothesis(number=2, size=-APART.size, deviation=0.01)


def test_a_length_that_agrees_with_no_hypothesis_repeats_the_question() -> None:
    left, operator = decided_by("33.5", "37.0", among=[APART, LONGER])
    assert {one.number for one in left} == {SPACING}
    assert any("30 or 37.5" in words for words in operator.messages)
    left, _ = decided_by("30.4", among=[APART, LONGER])
    assert {one.number for one in left} == {2}
    with pytest.raises(Stopped, match="ruler"):
        decided_by(*["50"] * 9, among=[APART, LONGER])


@pytest.mark.parametrize(("ruler", "number"), [("103", 0), ("121", ZERO)])
def test_a_ruler_distinguishes_a_wrong_zero_from_wrong_counts_of_an_angle(
    ruler: str, number: int
) -> None:
    zero = Hypothesis(number=ZERO, size=20.0, deviation=2.0)
    angle = Hypothesis(number=0, size=0.12, deviation=0.01)
    left, _ = decided_by(ruler, among=[zero, angle])
    assert [one.number for one in left] == [number]


INCHES = Hypothesis(number=1, size=float(np.log(25.4)))
TENTH = Hypothesis(number=0, size=-float(np.log(10.0)))


def test_the_travel_of_the_tool_identifies_the_angle_with_wrong_counts() -> None:
    left, operator = decided_by("0.7", "1.5", among=[INCHES, TENTH], mm=0.06)
    assert left == [INCHES]
    assert any("0.3 or 1.5" in words for words in operator.messages)
    assert decided_by("0", among=[INCHES, TENTH], mm=0.06)[0] == [TENTH]
    with pytest.raises(Stopped, match="joint 2"):
        decided_by(*["20"] * 9, among=[INCHES, TENTH], mm=0.06)


def test_all_hypotheses_remain_if_the_operator_cannot_measure() -> None:
    left = decided_by("unknown", among=[APART, LONGER])[0]
    assert {one.number for one in left} == {SPACING, 2}
    assert decided_by("UNKNOWN", among=[INCHES, TENTH], mm=0.06)[0] == [INCHES, TENTH]
    _, operator = decided_by("2500", "nan", "37 or 38", "37.0", among=[APART, LONGER])
    assert sum("or unknown" in words for words in operator.messages) == 3


def test_both_hypotheses_remain_if_the_motion_is_too_small_to_observe() -> None:
    left, operator = decided_by(among=[INCHES, TENTH], mm=0.02)
    assert left == [INCHES, TENTH]
    assert not any("marker 2" in words for words in operator.messages)


def test_a_question_repeats_until_the_answer_is_valid() -> None:
    operator = PreparedOperator("", "ja", "YES")
    assert ask_choice(operator, "Well?", ("yes", "no")) == "yes"
    assert len(operator.messages) == 2
    with pytest.raises(Stopped, match="no valid answer"):
        require_yes(PreparedOperator(*["perhaps"] * 9), "Well?")
    with pytest.raises(Stopped, match="the answer was no"):
        require_yes(PreparedOperator("no"), "Well?")
