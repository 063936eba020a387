"""A servo in plain words and numbers, and the servo that they describe: what a record needs to be
run again.

    {"mechanism": {"kind": "spherical", "limits": {…}, …}, "tool": {"kind": "rigid", …}, …, "rate":
    100.0}

Numbers come back bit for bit. An estimator that somebody else has made is told as module:class
with its settings, and comes back where the caller has named its class.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, make_dataclass
from typing import Any

from rcmservo.config.decode import decode
from rcmservo.config.kinds import ESTIMATORS, KINDS, Kinds, chosen, kind_in, name_of
from rcmservo.config.texts import is_table
from rcmservo.errors import BadInput
from rcmservo.method.estimators.base import Estimator
from rcmservo.servo.servo import Servo

Description: type[object] = make_dataclass(
    "Description", [*((box, object) for box in KINDS), ("rate", float)]
)
"""Every box of a servo, and its ticks a second."""

NOBODY: Mapping[str, type[Estimator]] = {}


def describe(servo: Servo) -> object:
    """The servo as it comes back from JSON: a table."""
    boxes = {box: _described(getattr(servo, box), kinds) for box, kinds in KINDS.items()}
    return json.loads(json.dumps({**boxes, "rate": servo.rate}, default=_plain))


def _described(value: Any, kinds: Kinds) -> object:
    names = [f.name for f in fields(value)] if is_dataclass(value) else []
    return {"kind": name_of(value, kinds), **{name: getattr(value, name) for name in names}}


def _plain(value: Any) -> object:
    """Settings within settings as a table; what JSON cannot hold in words."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else repr(value)


def rebuild(description: object, own: Mapping[str, type[Estimator]] = NOBODY) -> Servo:
    """The servo that was described, with the estimators that are the caller's `own` by their names;
    BadInput, naming the field, where that cannot be."""
    told: Any = decode(Description, description, "servo")
    kinds = {**KINDS, "estimator": {**ESTIMATORS, **own}}
    boxes = {box: _rebuilt(getattr(told, box), kinds[box], f"servo.{box}") for box in KINDS}
    return Servo(**boxes, rate=told.rate)


def rebuild_box(description: object, box: str) -> Any:
    """One box of the servo that was described, such as its ``mechanism``, whatever the others hold;
    BadInput where that cannot be."""
    table: object = description.get(box) if is_table(description) else None
    return _rebuilt(table, KINDS[box], f"servo.{box}")


def _rebuilt(table: object, kinds: Kinds, where: str) -> Any:
    """One box, with every one of its settings given: a default may change from version to
    version."""
    if not is_table(table):
        raise BadInput(where, table, "a table of settings")
    for f in fields(kind_in(kinds, table.get("kind"), where)):
        if f.name not in table:
            raise BadInput(f"{where}.{f.name}", None, "given")
    return chosen(kinds, table, where)
