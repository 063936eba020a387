"""A part of a record in which servo and target stay the same. One record holds one or more.

    {"origin": 0, "mid_run": false, "target": {"points": [[…], […]], "q": […]}, "servo": {…}}

A stage goes on from the last tick of an earlier one, whose number its ``origin`` is. A run begins
it, or a person who changed target or settings in mid-run.
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
    """Which servo and target a record's ticks go by, from one of them on."""

    first: int
    """Index of its first tick."""
    servo: Any
    """The description that its servo can be rebuilt from."""
    target: Target
    """What was shown."""
    origin: int
    """Number of the stage that it goes on from, or NOTHING or ELSEWHERE."""
    mid_run: bool = False
    """Whether the loop went on from the tick before, without a new start."""


def text_of(servo: Servo, target: Target, origin: int, mid_run: bool) -> str:
    """A stage as JSON."""
    told = {"points": target.points.tolist(), "q": target.q.tolist(), "shown": target.shown}
    table = {"origin": origin, "mid_run": mid_run, "target": told, "servo": describe(servo)}
    return json.dumps(table)


def stage_of(table: dict[str, Any], first: int, number: int) -> Stage:
    """The stage in a JSON object, the `number`-th of its record; ValueError where that is no
    stage."""
    try:
        target = table["target"]
        points, q = np.array(target["points"], dtype=float), np.array(target["q"], dtype=float)
        origin, servo, shown = table["origin"], table["servo"], target.get("shown", 0)
        mid_run = table.get("mid_run", False)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"it is no stage ({error})") from error
    good = type(origin) is int and ELSEWHERE <= origin < number and type(shown) is int
    follows = mid_run is False or (mid_run is True and number > 0 and origin == number - 1)
    if not (good and follows) or points.shape != (2, 2) or q.shape != (3,):
        raise ValueError("it is no stage")
    return Stage(first, servo, Target(points, q, shown), origin, mid_run)
