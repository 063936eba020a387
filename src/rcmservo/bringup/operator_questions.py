"""Questions to the operator, by which `rig check` decides what image and encoders leave open.

Image and encoders do not distinguish

- a mirrored image from one reversed angle,
- two reversed angles from a camera turned about the tool,
- a larger spacing of the markers from other counts per mm of the insertion,
- at some poses, different counts of one angle from those of the other, or from a different zero of
  the insertion.

The operator reports the direction and the length of a motion, and lengths on the tool by a ruler.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np

from rcmservo.bringup.axis_wiring import Robot
from rcmservo.bringup.hypotheses import Hypothesis, generate_equivalents
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
"""Words for the motion of the tool if joint 1, 2 or 3 increases, and if it decreases."""
DIRECTION_HINTS = {
    SPHERICAL: "away from that line or towards it, about it clockwise or anticlockwise, or further "
    "in or out",
    PITCH_YAW: "right or left, up or down, or further in or out",
}
"""Explanation of the words in `DIRECTIONS`, by kind of mechanism."""
REPEAT = "again"
"""Answer of an operator who requests the motion once more."""
MOTION_NOTICE = "{} moves in one direction, waits, and returns."
LENGTH_QUESTIONS: dict[str, Callable[[Floats], Any]] = {
    "By the ruler: how far apart are the middles of the two markers, in mm?": lambda markers: (
        math.dist(*markers)
    ),
    "By the ruler: how far is the middle of marker 1 from the entry point of the tool, about "
    "which it turns, in mm?": lambda markers: math.hypot(*markers[0]),
}
"""Questions for lengths (mm), with the lengths as functions of the markers (2, 3) in mm from the
RCM."""

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


def ask_operator(
    fits: Sequence[Hypothesis],
    robot: Robot,
    q: Floats,
    operator: OperatorTerminal,
    show_motion: ShowMotion,
    choose_motion: Callable[[int], float],
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
    show_motion
        Function that moves a joint for the operator.
    choose_motion
        Function that returns the motion (rad or mm) by which `show_motion` moves a joint.

    Returns
    -------
    list[Hypothesis]
        More than one if the answers do not distinguish them either.

    Raises
    ------
    Stopped
        If the operator refuses a motion, or no answer agrees with a hypothesis.
    """
    candidates = [candidate for fit in fits for candidate in generate_equivalents(fit)]
    for joint in range(3):
        if len({predict_direction(candidate, robot, joint) for candidate in candidates}) > 1:
            candidates = _select_by_direction(candidates, robot, joint, operator, show_motion)
    for question, compute_length in LENGTH_QUESTIONS.items():
        mm = _predict_lengths(candidates, robot, q, compute_length)
        if len(set(mm)) > 1:
            larger = [replace(h, size=h.size + SIZE_DEVIATIONS * h.deviation) for h in candidates]
            spread = np.abs(np.log(_predict_lengths(larger, robot, q, compute_length) / mm))
            tolerances = RULER_TOLERANCE + spread
            candidates = _select_by_length(candidates, mm, tolerances, question, operator)
    travels = np.array(
        [[h.compute_travel(robot, q, j, choose_motion(j)) for h in candidates] for j in range(3)]
    )
    travels = np.maximum(travels, MIN_TRAVEL_MM)
    ratios = travels.max(axis=1) / travels.min(axis=1)
    joint = int(np.argmax(ratios))
    if ratios[joint] > MIN_TRAVEL_RATIO:
        tolerances, name = np.full(len(candidates), TRAVEL_TOLERANCE), robot.describe_joint(joint)

        def show_travel() -> None:
            operator.notify(f"Watch marker 2 next to a ruler: {MOTION_NOTICE.format(name)}")
            show_motion(joint)

        question = f"For {name}, by the ruler: about how many mm did marker 2 move (0: hardly any)?"
        candidates = _select_by_length(
            candidates, travels[joint], tolerances, question, operator, show_travel
        )
    return candidates


def predict_direction(hypothesis: Hypothesis, robot: Robot, joint: int) -> str:
    """Return the word for the motion of the tool if `joint` is commanded upwards."""
    moving_joint, sign = hypothesis.predict_moving_joint(joint, robot.wiring)
    return DIRECTIONS[robot.mechanism.kind][moving_joint][0 if sign > 0 else 1]


def _predict_lengths(
    candidates: list[Hypothesis], robot: Robot, q: Floats, compute_length: Callable[[Floats], Any]
) -> Floats:
    """Return a length (mm) at the joints `q` (3,) under each hypothesis."""
    markers = [candidate.compute_markers(robot, q[None])[0] for candidate in candidates]
    return np.array([round(float(compute_length(pair)), 6) for pair in markers])


def _select_by_direction(
    candidates: list[Hypothesis],
    robot: Robot,
    joint: int,
    operator: OperatorTerminal,
    show_motion: ShowMotion,
) -> list[Hypothesis]:
    """Return the hypotheses that agree with the direction of motion that the operator observes."""
    kind, name = robot.mechanism.kind, robot.describe_joint(joint)
    choice = [word for pair in DIRECTIONS[kind] for word in pair]
    hint = DIRECTION_HINTS[kind]
    question = f"{VIEWPOINTS[kind]}: in which direction did the tool move first, {hint}?"
    predicted = [predict_direction(candidate, robot, joint) for candidate in candidates]
    for _ in range(MAX_ATTEMPTS):
        notice = MOTION_NOTICE.format(name)
        operator.notify(f"Watch the tool; {VIEWPOINTS[kind]}. {notice}")
        show_motion(joint)
        answer = ask_choice(operator, f"For {name}, {question}", (*choice, REPEAT))
        if answer in predicted:
            return list(compress(candidates, (word == answer for word in predicted)))
        if answer != REPEAT:
            words = " or ".join(sorted(set(predicted)))
            operator.notify(f"The image allows only {words}.")
    raise Stopped(f"none of {MAX_ATTEMPTS} answers agreed with the image for {name}")


def _select_by_length(
    candidates: list[Hypothesis],
    predicted_mm: Floats,
    tolerances: Floats,
    question: str,
    operator: OperatorTerminal,
    before_question: Callable[[], None] = lambda: None,
) -> list[Hypothesis]:
    """Return the hypotheses whose predicted lengths agree with the operator's ruler.

    Return all of them if the operator cannot measure the length. The logarithms of predicted and
    measured length may differ by `tolerances`.
    """
    lengths = " or ".join(dict.fromkeys(f"{mm:.3g}" for mm in sorted(predicted_mm)))
    for _ in range(MAX_ATTEMPTS):
        before_question()
        measured_mm = ask_length(operator, question)
        if measured_mm is None:
            return candidates
        error = np.abs(np.log(predicted_mm / max(measured_mm, MIN_TRAVEL_MM)))
        if (error <= tolerances).any():
            return list(compress(candidates, error <= tolerances))
        operator.notify(f"The image allows only about {lengths} mm.")
    raise Stopped(f"no answer agreed with the {lengths} mm of the image to: {question}")
