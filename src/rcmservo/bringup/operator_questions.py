"""Questions to the operator that decide between hypotheses which image and encoders leave open.

Image and encoders do not distinguish

- a mirrored image from one reversed angle,
- two reversed angles from a camera turned about the tool,
- a larger spacing of the markers from different counts of the insertion,
- at some poses, different counts of one angle from those of the other, or from a different zero of
  the insertion.

The operator decides by the direction and the length of a motion, and by measuring the tool with a
ruler.
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
    SPHERICAL: "look from the entry point of the tool along the line theta = 0",
    PITCH_YAW: "look from the entry point of the tool along the tool at q = 0, with the yaw axis "
    "up",
}
"""Viewpoint of the operator, by kind of mechanism."""
DIRECTIONS = {
    SPHERICAL: (("away", "towards"), ("clockwise", "anticlockwise"), ("in", "out")),
    PITCH_YAW: (("right", "left"), ("down", "up"), ("in", "out")),
}
"""Words for the motion of the tool if joint 1, 2 or 3 rises, and if it falls."""
DIRECTION_HINTS = {
    SPHERICAL: "away from that line or towards it, about it clockwise or anticlockwise, or further "
    "in or out",
    PITCH_YAW: "right or left, up or down, or further in or out",
}
"""Explanation of the words in `DIRECTIONS`, by kind of mechanism."""
REPEAT = "again"
"""Answer of an operator who wants to observe the motion once more."""
MOTION_NOTICE = "{} moves in one direction, waits, and returns."

RULER_TOLERANCE = 0.05
"""Relative error of a measurement by ruler."""
SIZE_DEVIATIONS = 2.0
"""Standard deviations of the fitted size that are added to `RULER_TOLERANCE`."""
TRAVEL_TOLERANCE = float(np.log(1.7))
"""Tolerance on the logarithm of a travel that the operator estimates."""
MIN_TRAVEL_MM = 0.3
"""Smallest travel that an operator perceives; shorter ones count as this."""
MIN_TRAVEL_RATIO = 3.0
"""Smallest ratio of two travels that an operator distinguishes."""

ShowMotion = Callable[[int], None]
"""Function that asks for agreement and moves a joint up and back while the operator watches."""


def direction(hypothesis: Hypothesis, robot: Robot, joint: int) -> str:
    """Return the word for the motion of the tool if `joint` is commanded upwards."""
    actual, sign = hypothesis.moves(joint, robot.wiring)
    return DIRECTIONS[robot.mechanism.kind][actual][0 if sign > 0 else 1]


def ask_operator(
    fits: Sequence[Hypothesis],
    robot: Robot,
    q: Floats,
    operator: OperatorTerminal,
    show: ShowMotion,
    motion: Callable[[int], float],
) -> list[Hypothesis]:
    """Return the hypotheses that agree with the fits and with the operator's answers.

    Parameters
    ----------
    fits
        Most likely hypotheses, each standing for those that an image does not distinguish from it.
    robot
        Arm as the rig file describes it.
    q
        Joints (3,) at the start of the check, where the tool is now.
    operator
        Operator.
    show
        Function that moves a joint for the operator.
    motion
        Function that returns the motion (rad or mm) by which `show` moves a joint.

    Returns
    -------
    list[Hypothesis]
        More than one if the answers do not distinguish them either.

    Raises
    ------
    Stopped
        If the operator refuses a motion, or no answer agrees with a hypothesis.
    """
    left = [other for fit in fits for other in equivalents(fit)]
    for joint in range(3):
        if len({direction(one, robot, joint) for one in left}) > 1:
            left = _by_direction(left, robot, joint, operator, show)
    for question, length in LENGTHS.items():
        mm = _predicted(left, robot, q, length)
        if len(set(mm)) > 1:
            larger = [replace(h, size=h.size + SIZE_DEVIATIONS * h.deviation) for h in left]
            spread = np.abs(np.log(_predicted(larger, robot, q, length) / mm))
            left = _by_length(left, mm, RULER_TOLERANCE + spread, question, operator)
    travels = np.array([[h.travel(robot, q, j, motion(j)) for h in left] for j in range(3)])
    travels = np.maximum(travels, MIN_TRAVEL_MM)
    ratios = travels.max(axis=1) / travels.min(axis=1)
    joint = int(np.argmax(ratios))
    if ratios[joint] > MIN_TRAVEL_RATIO:
        tolerance, name = np.full(len(left), TRAVEL_TOLERANCE), robot.name(joint)

        def show_travel() -> None:
            operator.notify(f"Watch marker 2 next to a ruler: {MOTION_NOTICE.format(name)}")
            show(joint)

        question = f"For {name}, by the ruler: about how many mm did marker 2 move (0: hardly any)?"
        left = _by_length(left, travels[joint], tolerance, question, operator, show_travel)
    return left


def _by_direction(
    left: list[Hypothesis], robot: Robot, joint: int, operator: OperatorTerminal, show: ShowMotion
) -> list[Hypothesis]:
    """Return the hypotheses that agree with the direction of motion that the operator observes."""
    kind, name = robot.mechanism.kind, robot.name(joint)
    choice = [word for pair in DIRECTIONS[kind] for word in pair]
    hint = DIRECTION_HINTS[kind]
    question = f"{VIEWPOINTS[kind]}: in which direction did the tool move first, {hint}?"
    predicted = [direction(one, robot, joint) for one in left]
    for _ in range(MAX_ATTEMPTS):
        operator.notify(f"Watch the tool: {MOTION_NOTICE.format(name)}")
        show(joint)
        answer = ask_choice(operator, f"For {name}, {question}", (*choice, REPEAT))
        if answer in predicted:
            return [one for one, word in zip(left, predicted, strict=True) if word == answer]
        if answer != REPEAT:
            words = " or ".join(sorted(set(predicted)))
            operator.notify(f"The image allows only {words}. The motion is repeated.")
    raise Stopped(f"no answer agreed with the image for {name}")


def _marker_distance(markers: Floats) -> float:
    return float(np.linalg.norm(markers[1] - markers[0]))


def _first_marker_depth(markers: Floats) -> float:
    return float(np.linalg.norm(markers[0]))


LENGTHS = {
    "By the ruler: how far apart are the middles of the two markers, in mm?": _marker_distance,
    "By the ruler: how far is the middle of marker 1 from the entry point of the tool, about "
    "which it turns, in mm?": _first_marker_depth,
}
"""Lengths (mm) that a ruler measures, as functions of the markers (2, 3) in mm from the RCM."""


def _predicted(
    left: list[Hypothesis], robot: Robot, q: Floats, length: Callable[[Floats], float]
) -> Floats:
    return np.array([round(length(one.markers(robot, q[None])[0]), 6) for one in left])


def _by_length(
    left: list[Hypothesis],
    predicted: Floats,
    tolerance: Floats,
    question: str,
    operator: OperatorTerminal,
    show: Callable[[], None] = lambda: None,
) -> list[Hypothesis]:
    """Return the hypotheses whose `predicted` length (mm) agrees with the operator's ruler.

    Return all of them if the operator cannot measure the length.
    """
    could = " or ".join(f"{mm:.3g}" for mm in sorted(set(predicted)))
    for _ in range(MAX_ATTEMPTS):
        show()
        mm = ask_length(operator, question)
        if mm is None:
            return left
        agrees = np.abs(np.log(predicted / max(mm, MIN_TRAVEL_MM))) <= tolerance
        if agrees.any():
            return list(compress(left, agrees))
        operator.notify(f"The image allows only about {could} mm. Repeat the measurement.")
    raise Stopped(f"no answer agreed with the {could} mm of the image to: {question}")
