"""A run within a record: which servo, which target, and what it goes on from. One record holds one
or more.

    {"origin": 0, "target": {"points": [[…], […]], "q": […]}, "servo": {…}}

A stage goes on from the last tick of an earlier one, whose number its ``origin`` is.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo.config.decode import decode
from rcmservo.config.servo_json import describe
from rcmservo.errors import require
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


@dataclass(frozen=True)
class Shown:
    """A target as a stage's JSON has it."""

    points: tuple[tuple[float, float], tuple[float, float]]
    q: tuple[float, float, float]
    shown: int = 0


@dataclass(frozen=True)
class Told:
    """A stage's JSON."""

    origin: int
    target: Shown
    servo: dict[str, Any]


def stage_of(table: object, first: int, number: int) -> Stage:
    """The stage in a JSON object, the `number`-th of its record; BadInput where that is no
    stage."""
    told = decode(Told, table, "stage")
    require(ELSEWHERE <= told.origin < number, "stage.origin", told.origin, "an earlier stage")
    target = Target(np.array(told.target.points), np.array(told.target.q), told.target.shown)
    return Stage(first, told.servo, target, told.origin)
