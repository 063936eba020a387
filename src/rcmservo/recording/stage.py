"""Stages of a record: sections with one servo and one target.

    {"origin": 0, "mid_run": false, "target": {"points": [[…], […]], "q": […], "sizes": […]},
     "servo": {…}, "version": "0.2.0", "source": ""}

A stage may continue from the last tick of an earlier stage, whose number is its ``origin``. A new
run begins a stage, and so does a change of target or settings during a run.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from rcmservo import __version__
from rcmservo.config.servo_json import describe_servo
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import UNKNOWN_RADII, MarkerRadii, Table, radii_to_json
from rcmservo.config.user_estimators import hash_source
from rcmservo.errors import require
from rcmservo.interfaces import Target
from rcmservo.servo.servo import Servo

NO_ORIGIN, UNRECORDED_ORIGIN = -1, -2
"""Origin of a stage that starts from the initial state, and of one that continues from a state
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


def stage_text(servo: Servo, target: Target, origin: int, mid_run: bool) -> str:
    """Return a stage as JSON."""
    aim = {"points": target.points.tolist(), "q": target.q.tolist(), "shown": target.taught_at}
    aim["sizes"] = radii_to_json(target.sizes)
    stage = {"origin": origin, "mid_run": mid_run, "target": aim, "servo": describe_servo(servo)}
    written_by = {"version": __version__, "source": hash_source(servo.estimator)}
    return json.dumps({**stage, **written_by})


@dataclass(frozen=True)
class TargetTable:
    """Target in the JSON of a stage.

    Parameters
    ----------
    points : tuple[tuple[float, float], tuple[float, float]]
        (u, v) in raw px of marker 1, then of marker 2.
    q : tuple[float, float, float]
        Joints in rad, rad, mm.
    shown : int
        Time at which the target was taught, in ns on the plant's clock; 0 if unknown.
    sizes : MarkerRadii
        Apparent radii of both markers in px; null if unknown.
    """

    points: tuple[tuple[float, float], tuple[float, float]]
    q: tuple[float, float, float]
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


def stage_of(table: object, first: int, number: int) -> Stage:
    """Return the stage in a JSON object, number `number` of its record.

    Raises
    ------
    BadInput
        If the object is no stage.
    """
    decoded = decode_settings(StageTable, table, "stage")
    last, origin = number - 1, decoded.origin
    require(UNRECORDED_ORIGIN <= origin <= last, "stage.origin", origin, "an earlier stage")
    is_consistent = not decoded.mid_run or origin == last >= 0
    require(is_consistent, "stage.origin", origin, "the previous stage, whose run it continues")
    target, written_by = _target(decoded.target), (decoded.version, decoded.source)
    return Stage(first, decoded.servo, target, origin, decoded.mid_run, *written_by)


def _target(decoded: TargetTable) -> Target:
    radii = np.array(decoded.sizes, dtype=np.float64)
    return Target(np.array(decoded.points), np.array(decoded.q), decoded.shown, radii)
