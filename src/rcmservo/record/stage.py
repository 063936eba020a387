"""A run within a record: which servo, which target, and what it goes on from. One record holds one
or more.

    {"origin": 0, "target": {"points": [[…], […]], "q": […]}, "servo": {…}}

A stage goes on from the last tick of an earlier one, whose number its ``origin`` is.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.config.servo_json import describe
from rcmservo.interfaces import Target
from rcmservo.servo.servo import Servo

NOTHING, ELSEWHERE = -1, -2
"""The origin of a stage that begins from nothing, or goes on from a state that the record does not
hold."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A run, from the tick with the index ``first`` on.

    ``servo`` is the description that it can be rebuilt from.
    """

    first: int
    servo: Any
    target: Target
    origin: int


def text_of(servo: Servo, target: Target, origin: int) -> str:
    """A stage as JSON."""
    told = {"points": target.points.tolist(), "q": target.q.tolist(), "shown": target.shown}
    return json.dumps({"origin": origin, "target": told, "servo": describe(servo)})


def stage_of(table: dict[str, Any], first: int, number: int) -> Stage:
    """The stage in a JSON object, the `number`-th of its record; ValueError where that is no
    stage."""
    try:
        target = table["target"]
        points, q = np.array(target["points"], dtype=float), np.array(target["q"], dtype=float)
        origin, servo, shown = table["origin"], table["servo"], target.get("shown", 0)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"it is no stage ({error})") from error
    good = type(origin) is int and ELSEWHERE <= origin < number and type(shown) is int
    if not good or points.shape != (2, 2) or q.shape != (3,):
        raise ValueError("it is no stage")
    return Stage(first, servo, Target(points, q, shown), origin)
