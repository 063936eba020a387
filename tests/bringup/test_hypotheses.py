"""What a camera can tell of a rig file's mistakes, and what a person is asked."""

from dataclasses import replace

import numpy as np
import pytest

from rcmservo.bringup.axis_wiring import Robot, Wiring
from rcmservo.bringup.corrections import corrections
from rcmservo.bringup.hypotheses import (
    Hypothesis,
    equivalents,
    fit_all,
    most_likely,
)
from rcmservo.bringup.identification import SPACING, ZERO, MarkerViews
from rcmservo.bringup.operator_questions import ask_operator
from rcmservo.bringup.prompts import ask_choice, require_yes
from rcmservo.errors import Stopped
from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.geometry.tool import RigidTool
from rcmservo.sim import Rig

ROBOT = Robot(SphericalRcm(), RigidTool(spacing=30.0), Wiring((5e4, 5e4, 500.0), axes="ABC"))


class Mute:
    """A person who answers with what was written down."""

    def __init__(self, *answers: str) -> None:
        self.answers, self.told = list(answers), []

    def tell(self, words: str) -> None:
        self.told.append(words)

    def ask(self, question: str) -> str:
        return self.answers.pop(0)


def views(seed: int, guess: Hypothesis) -> MarkerViews:
    """What is seen where a guess is true and each joint goes a mm to either side."""
    rig = Rig(seed, pictures=False)
    start = rig.scene.start
    ways = np.diag(ROBOT.joint_per_mm(start))
    q = start + np.concatenate([np.zeros((1, 3)), ways, -ways])
    points = np.stack([rig.scene.optics.project(two) for two in guess.markers(ROBOT, q)])
    seen = MarkerViews(q, points, np.full(len(q), 0.03), (640, 480))
    return seen.mirrored() if guess.mirrored else seen


@pytest.mark.parametrize(
    "guess",
    [
        Hypothesis(),
        Hypothesis(order=(1, 0, 2)),
        Hypothesis(reversed=(True, False, False)),
        Hypothesis(mirrored=True),
        Hypothesis(number=0, size=float(np.log(2.0))),
    ],
)
def test_what_is_true_is_among_the_few_that_are_believed(guess: Hypothesis) -> None:
    left = most_likely(fit_all(ROBOT, views(2, guess)))
    assert len(left) == 1
    assert guess in list(equivalents(left[0]))


def test_a_set_that_no_picture_tells_apart_holds_four_signs_and_mirrors() -> None:
    left = most_likely(fit_all(ROBOT, views(2, Hypothesis())))
    together = {(m.reversed, m.mirrored) for m in equivalents(left[0])}
    assert together == {
        ((False, False, False), False),
        ((True, True, False), False),
        ((True, False, False), True),
        ((False, True, False), True),
    }


def test_axes_that_change_places_take_the_signs_of_their_counts_with_them() -> None:
    robot = replace(ROBOT, wiring=Wiring((5e4, -5e4, 500.0), axes="ABC"))
    swapped, start = Hypothesis(order=(1, 0, 2)), np.array([0.1, 0.2, 100.0])
    told = start + np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    truly = start + np.array([[0.0, 0.0, 0.0], [0.0, -0.01, 0.0]])
    assert np.allclose(swapped.markers(robot, told), Hypothesis().markers(robot, truly))
    assert swapped.moves(0, robot.wiring) == (1, -1)
    assert swapped.moves(2, robot.wiring) == (2, 1)
    assert swapped.moves(0, ROBOT.wiring) == (1, 1)


def test_each_guess_of_a_set_is_told_as_surely_as_its_own_number_is_known() -> None:
    left = most_likely(fit_all(ROBOT, views(2, Hypothesis(number=SPACING, size=0.25))))
    for guess in (member for kind in left for member in equivalents(kind)):
        told = [one for one in corrections(guess, ROBOT) if "%" in one.what + one.expected]
        assert told
        assert not any("to 0 %" in one.what + one.expected for one in told)


def decided_by(
    *answers: str, among: list[Hypothesis], mm: float = 1.0
) -> tuple[list[Hypothesis], Mute]:
    """What is left of these by a ruler, by a person who sees which way each joint goes; joints are
    shown over so many mm.
    """
    person = Mute(*answers)
    start = np.array([0.3, 0.2, 100.0])

    def show(joint: int) -> None:
        if person.told[-1].startswith("Watch the tool"):
            person.answers.insert(0, ["away", "clockwise", "in"][joint])

    def way(joint: int) -> float:
        return mm * ROBOT.joint_per_mm(start)[joint]

    return ask_operator(among, ROBOT, start, person, show, way), person


APART = Hypothesis(number=SPACING, size=float(np.log(1.25)), deviation=0.01)
LONGER = Hypothesis(number=2, size=-APART.size, deviation=0.01)


def test_a_ruler_that_agrees_with_no_guess_is_asked_for_again() -> None:
    left, person = decided_by("33.5", "37.0", among=[APART, LONGER])
    assert {guess.number for guess in left} == {SPACING}
    assert any("30 or 37.5" in words for words in person.told)
    left, _ = decided_by("30.4", among=[APART, LONGER])
    assert {guess.number for guess in left} == {2}
    with pytest.raises(Stopped, match="ruler"):
        decided_by(*["50"] * 9, among=[APART, LONGER])


@pytest.mark.parametrize(("ruler", "number"), [("103", 0), ("121", ZERO)])
def test_a_ruler_tells_another_zero_from_an_angle_that_counts_otherwise(
    ruler: str, number: int
) -> None:
    zero = Hypothesis(number=ZERO, size=20.0, deviation=2.0)
    angle = Hypothesis(number=0, size=0.12, deviation=0.01)
    left, _ = decided_by(ruler, among=[zero, angle])
    assert [guess.number for guess in left] == [number]


INCHES = Hypothesis(number=1, size=float(np.log(25.4)))
TENTH = Hypothesis(number=0, size=-float(np.log(10.0)))


def test_how_far_the_tool_went_tells_which_angle_counts_otherwise() -> None:
    left, person = decided_by("0.7", "1.5", among=[INCHES, TENTH], mm=0.06)
    assert left == [INCHES]
    assert any("0.3 or 1.5" in words for words in person.told)
    assert decided_by("0", among=[INCHES, TENTH], mm=0.06)[0] == [TENTH]
    with pytest.raises(Stopped, match="joint 2"):
        decided_by(*["20"] * 9, among=[INCHES, TENTH], mm=0.06)


def test_where_nobody_can_measure_it_all_are_left() -> None:
    left = decided_by("unknown", among=[APART, LONGER])[0]
    assert {guess.number for guess in left} == {SPACING, 2}
    assert decided_by("UNKNOWN", among=[INCHES, TENTH], mm=0.06)[0] == [INCHES, TENTH]
    _, person = decided_by("2500", "nan", "37 or 38", "37.0", among=[APART, LONGER])
    assert sum("or unknown" in words for words in person.told) == 3


def test_where_the_tool_goes_too_little_to_be_seen_both_are_left() -> None:
    left, person = decided_by(among=[INCHES, TENTH], mm=0.02)
    assert left == [INCHES, TENTH]
    assert not any("marker 2" in words for words in person.told)


def test_a_question_is_asked_again_until_the_answer_can_be_one() -> None:
    person = Mute("", "ja", "YES")
    assert ask_choice(person, "Well?", ("yes", "no")) == "yes"
    assert len(person.told) == 2
    with pytest.raises(Stopped, match="no valid answer"):
        require_yes(Mute(*["perhaps"] * 9), "Well?")
    with pytest.raises(Stopped, match="the answer was no"):
        require_yes(Mute("no"), "Well?")
