"""A part of a record in which servo and target stay the same. One record holds one or more.

    {"origin": 0, "mid_run": false, "target": {"points": [[…], […]], "q": […], "sizes": […]},
     "servo": {…}, "version": "0.2.0", "source": ""}

A stage goes on from the last tick of an earlier one, whose number its ``origin`` is. A run begins
it, or a person who changed target or settings in mid-run.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo import __version__
from rcmservo.config.decode import decode
from rcmservo.config.own_code import source
from rcmservo.config.servo_json import describe
from rcmservo.config.texts import NO_SIZES, Sizes, Table, sizes
from rcmservo.errors import require
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
    version: str = ""
    """Which rcmservo has written it; empty where it does not tell."""
    source: str = ""
    """Hash of the file of a user's own estimator; empty for ours."""


def text_of(servo: Servo, target: Target, origin: int, mid_run: bool) -> str:
    """A stage as JSON."""
    told = {"points": target.points.tolist(), "q": target.q.tolist(), "shown": target.shown}
    told["sizes"] = sizes(target.sizes)
    stage = {"origin": origin, "mid_run": mid_run, "target": told, "servo": describe(servo)}
    by = {"version": __version__, "source": source(servo.estimator)}
    return json.dumps({**stage, **by})


@dataclass(frozen=True)
class TargetTable:
    """A target as a stage's JSON has it."""

    points: tuple[tuple[float, float], tuple[float, float]]
    """(u, v) raw px of marker 1, then of marker 2."""
    q: tuple[float, float, float]
    """rad, rad, mm."""
    shown: int = 0
    """ns on the plant's clock; 0 where the JSON does not tell."""
    sizes: Sizes = NO_SIZES
    """Apparent radii of both markers, px; null where not known, or where the JSON does not tell."""


@dataclass(frozen=True)
class StageTable:
    """A stage's JSON. Where it stands in the record tells its first tick."""

    origin: int
    """Number of the stage that it goes on from, or NOTHING or ELSEWHERE."""
    target: TargetTable
    """What was shown."""
    servo: Table
    """The description that its servo can be rebuilt from."""
    mid_run: bool = False
    """Whether the loop went on from the tick before, without a new start."""
    version: str = ""
    """Which rcmservo has written it; empty where it does not tell."""
    source: str = ""
    """Hash of the file of a user's own estimator; empty for ours."""


def stage_of(table: object, first: int, number: int) -> Stage:
    """The stage in a JSON object, the `number`-th of its record; BadInput where that is no
    stage."""
    told = decode(StageTable, table, "stage")
    last = number - 1
    require(ELSEWHERE <= told.origin <= last, "stage.origin", told.origin, "an earlier stage")
    follows = not told.mid_run or told.origin == last >= 0
    require(follows, "stage.origin", told.origin, "the stage before, as it goes on in mid-run")
    by = told.version, told.source
    return Stage(first, told.servo, _shown(told.target), told.origin, told.mid_run, *by)


def _shown(told: TargetTable) -> Target:
    """The target that a table tells."""
    radii = np.array(told.sizes, dtype=np.float64)
    return Target(np.array(told.points), np.array(told.q), told.shown, radii)
