"""Questions to the operator where picture and encoders cannot distinguish hypotheses.

They do not distinguish a mirrored picture from one reversed angle, nor both angles reversed from a
camera turned about the tool, nor a larger spacing of the markers from other counts of the
insertion. At some poses they do not distinguish other counts of an angle from other counts of the
other one or from another zero of the insertion. The direction and the length of a motion, and a
ruler on the tool, do.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.hypotheses import Hypothesis, equivalents
from rcmservo.bringup.prompts import MAX_ATTEMPTS, ask_choice, ask_length
from rcmservo.errors import Stopped
from rcmservo.geometry.kinematics import PITCH_YAW, SPHERICAL
from rcmservo.interfaces import Floats
from rcmservo.live.device_protocols import OperatorTerminal

VIEWPOINTS = {
    SPHERICAL: "look from the point where the tool goes in, along the line theta = 0",
    PITCH_YAW: "look from the point where the tool goes in along the tool at q = 0, the yaw axis "
    "up",
}
"""Viewpoint of the operator, by the kind of mechanism."""
DIRECTIONS = {
    SPHERICAL: (("away", "towards"), ("clockwise", "anticlockwise"), ("in", "out")),
    PITCH_YAW: (("right", "left"), ("down", "up"), ("in", "out")),
}
"""Motion of the tool when joint 1, 2 or 3 rises, or falls."""
MEANINGS = {
    SPHERICAL: "away from that line or towards it, about it clockwise or anticlockwise, or further "
    "in or out",
    PITCH_YAW: "right or left, up or down, or further in or out",
}
AGAIN = "again"
SHOWN = "{} goes one way, waits, and comes back."

RULER_TOLERANCE = 0.05
"""Relative error of a ruler,"""
SIZE_DEVIATIONS = 2.0
"""in addition to so many standard deviations of the fitted size."""
TRAVEL_TOLERANCE = float(np.log(1.7))
"""Error of the logarithm of a travel that the operator measures."""
MIN_TRAVEL_MM = 0.3
"""Travel that an operator sees; all shorter ones look like this."""
MIN_TRAVEL_RATIO = 3.0
"""Ratio of two travels that an operator distinguishes."""

Show = Callable[[int], None]
"""Move a joint up and back for the operator, who has agreed."""


def direction(hypothesis: Hypothesis, robot: Robot, joint: int) -> str:
    """Return the word for the motion of the tool when a joint is commanded up."""
    true, sign = hypothesis.moves(joint, robot.wiring)
    return DIRECTIONS[robot.mechanism.kind][true][0 if sign > 0 else 1]


def ask_operator(
    fits: Sequence[Hypothesis],
    robot: Robot,
    q: Floats,
    person: OperatorTerminal,
    show: Show,
    motion: Callable[[int], float],
) -> list[Hypothesis]:
    """Return the hypotheses equivalent to these fits that agree with the operator's answers.

    Several remain if the answers do not distinguish them either. The tool is at q (3,) with its
    joints where the check began; `show` moves a joint by its `motion` in rad or mm.
    """
    left = [other for fit in fits for other in equivalents(fit)]
    for joint in range(3):
        if len({direction(one, robot, joint) for one in left}) > 1:
            left = _by_direction(left, robot, joint, person, show)
    for question, length in LENGTHS.items():
        mm = _predicted(left, robot, q, length)
        if len(set(mm)) > 1:
            larger = [replace(h, size=h.size + SIZE_DEVIATIONS * h.deviation) for h in left]
            spread = np.abs(np.log(_predicted(larger, robot, q, length) / mm))
            left = _by_length(left, mm, RULER_TOLERANCE + spread, question, person)
    travels = np.array([[h.travel(robot, q, j, motion(j)) for h in left] for j in range(3)])
    travels = np.maximum(travels, MIN_TRAVEL_MM)
    ratios = travels.max(axis=1) / travels.min(axis=1)
    joint = int(np.argmax(ratios))
    if ratios[joint] > MIN_TRAVEL_RATIO:
        tolerance, name = np.full(len(left), TRAVEL_TOLERANCE), robot.name(joint)

        def show_travel() -> None:
            person.tell(f"Watch marker 2, with a ruler beside it: {SHOWN.format(name)}")
            show(joint)

        question = f"For {name}, by the ruler: about how many mm did marker 2 go (0: hardly any)?"
        left = _by_length(left, travels[joint], tolerance, question, person, show_travel)
    return left


def _by_direction(
    left: list[Hypothesis], robot: Robot, joint: int, person: OperatorTerminal, show: Show
) -> list[Hypothesis]:
    """Keep the hypotheses for which the tool moves in the direction that the operator sees."""
    kind, name = robot.mechanism.kind, robot.name(joint)
    choice = [word for pair in DIRECTIONS[kind] for word in pair]
    question = f"{VIEWPOINTS[kind]}: which way did the tool go first, {MEANINGS[kind]}?"
    predicted = [direction(one, robot, joint) for one in left]
    for _ in range(MAX_ATTEMPTS):
        person.tell(f"Watch the tool: {SHOWN.format(name)}")
        show(joint)
        answer = ask_choice(person, f"For {name}, {question}", (*choice, AGAIN))
        if answer in predicted:
            return [one for one, word in zip(left, predicted, strict=True) if word == answer]
        if answer != AGAIN:
            words = " or ".join(sorted(set(predicted)))
            person.tell(f"By the picture it can only have been {words}. It is shown again.")
    raise Stopped(f"no answer agreed with the picture for {name}")


def _marker_distance(markers: Floats) -> float:
    return float(np.linalg.norm(markers[1] - markers[0]))


def _first_marker_depth(markers: Floats) -> float:
    return float(np.linalg.norm(markers[0]))


LENGTHS = {
    "By the ruler: how far apart are the middles of the two markers, in mm?": _marker_distance,
    "By the ruler: how far is the middle of marker 1 from the point where the tool goes in, "
    "about which it turns, in mm?": _first_marker_depth,
}
"""Lengths (mm) of the tool that a ruler measures, of the markers (2, 3) seen from the RCM."""


def _predicted(
    left: list[Hypothesis], robot: Robot, q: Floats, length: Callable[[Floats], float]
) -> Floats:
    return np.array([round(length(one.markers(robot, q[None])[0]), 6) for one in left])


def _by_length(
    left: list[Hypothesis],
    predicted: Floats,
    tolerance: Floats,
    question: str,
    person: OperatorTerminal,
    show: Callable[[], None] = lambda: None,
) -> list[Hypothesis]:
    """Keep the hypotheses whose length is that of the ruler; all if nobody can measure it."""
    could = " or ".join(f"{mm:.3g}" for mm in sorted(set(predicted)))
    for _ in range(MAX_ATTEMPTS):
        show()
        mm = ask_length(person, question)
        if mm is None:
            return left
        agrees = np.abs(np.log(predicted / max(mm, MIN_TRAVEL_MM))) <= tolerance
        if agrees.any():
            return list(compress(left, agrees))
        person.tell(f"By the picture it can only be about {could} mm. Measure it again.")
    raise Stopped(f"no answer agreed with the picture's {could} mm to: {question}")
