"""Stages of a record: sections of ticks with one servo and one target, stored as JSON.

    {"origin": 0, "mid_run": false, "target": {"points": [[…], […]], "q": […], "sizes": […]},
     "servo": {…}, "version": "0.2.0", "source": ""}

A new run begins a stage, and so does a change of target or settings during a run. A stage may
continue from the state at the last tick of an earlier stage. The number of that stage, counted from
0 in the record, is then its ``origin``.
"""

import json
from dataclasses import dataclass
from importlib.metadata import version as find_version
from typing import Any

import numpy as np

from rcmservo.config.servo_json import describe_servo
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import (
    UNKNOWN_RADII,
    MarkerRadii,
    Table,
    convert_unknown_to_null,
)
from rcmservo.config.user_estimators import hash_source
from rcmservo.errors import require
from rcmservo.interfaces import Target
from rcmservo.servo.servo import Servo

NO_ORIGIN, UNRECORDED_ORIGIN = -1, -2
"""Origins of a stage that starts from the initial state, and of a stage that continues from a state
outside the record."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Servo and target of a section of ticks.

    Parameters
    ----------
    first : int
        Index of the first tick.
    servo : Any
        Description from which the servo can be rebuilt.
    target : Target
        Target of the stage.
    origin : int
        Number of the stage that it continues, or `NO_ORIGIN` or `UNRECORDED_ORIGIN`.
    mid_run : bool
        True if the loop continued from the previous tick without a restart.
    version : str
        Version of rcmservo that wrote the stage; empty if unknown.
    source : str
        Hash of the source file of a user-defined estimator; empty for a built-in one.
    """

    first: int
    servo: Any
    target: Target
    origin: int
    mid_run: bool = False
    version: str = ""
    source: str = ""


def format_stage(servo: Servo, target: Target, origin: int, mid_run: bool) -> str:
    """Return a stage as JSON."""
    taught = {
        "points": target.points.tolist(),
        "q": convert_unknown_to_null(target.q),
        "shown": target.taught_at,
    }
    taught["sizes"] = convert_unknown_to_null(target.sizes)
    stage = {"origin": origin, "mid_run": mid_run, "target": taught, "servo": describe_servo(servo)}
    written_by = {"version": find_version("rcmservo"), "source": hash_source(servo.estimator)}
    return json.dumps(stage | written_by)


def parse_stage(table: object, first: int, number: int) -> Stage:
    """Return the stage in a JSON object.

    Parameters
    ----------
    table : object
        Parsed JSON object.
    first : int
        Index of the stage's first tick.
    number : int
        Number of the stage within its record, from 0.

    Raises
    ------
    BadInput
        If the object is no stage.
    """
    decoded = decode_settings(StageTable, table, "stage")
    previous, origin = number - 1, decoded.origin
    require(UNRECORDED_ORIGIN <= origin <= previous, "stage.origin", origin, "an earlier stage")
    is_consistent = not decoded.mid_run or origin == previous >= 0
    require(is_consistent, "stage.origin", origin, "the previous stage, whose run it continues")
    points, q = np.array(decoded.target.points), np.array(decoded.target.q, dtype=np.float64)
    radii = np.array(decoded.target.sizes, dtype=np.float64)
    target = Target(points, q, decoded.target.shown, radii)
    recorded: dict[str, Any] = vars(decoded) | {"target": target}
    return Stage(first, **recorded)


@dataclass(frozen=True)
class TargetTable:
    """Target in the JSON of a stage.

    Parameters
    ----------
    points : tuple[tuple[float, float], tuple[float, float]]
        (u, v) in raw px of marker 1, then of marker 2.
    q : tuple
        Joints in rad, rad, mm; null if unknown.
    shown : int
        Time at which the target was taught, in ns on the plant's clock; 0 if unknown.
    sizes : MarkerRadii
        Apparent radii of both markers in px; null if unknown.
    """

    points: tuple[tuple[float, float], tuple[float, float]]
    q: tuple[float | None, float | None, float | None]
    shown: int = 0
    sizes: MarkerRadii = UNKNOWN_RADII


@dataclass(frozen=True)
class StageTable:
    """JSON of a stage. Its position in the record determines its first tick.

    Parameters
    ----------
    origin : int
        Number of the stage that it continues, or `NO_ORIGIN` or `UNRECORDED_ORIGIN`.
    target : TargetTable
        Target of the stage.
    servo : Table
        Description from which the servo can be rebuilt.
    mid_run : bool
        True if the loop continued from the previous tick without a restart.
    version : str
        Version of rcmservo that wrote the stage; empty if unknown.
    source : str
        Hash of the source file of a user-defined estimator; empty for a built-in one.
    """

    origin: int
    target: TargetTable
    servo: Table
    mid_run: bool = False
    version: str = ""
    source: str = ""
