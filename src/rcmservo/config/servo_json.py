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

from rcmservo.config.former_names import with_present_names
from rcmservo.config.registry import (
    ESTIMATORS,
    KIND,
    PARTS,
    Classes,
    decode_kind,
    find_class,
    name_of,
)
from rcmservo.config.strict_decoding import decode
from rcmservo.config.texts import Table, is_table
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo

Description: type[object] = make_dataclass(
    "Description", [*((part, object) for part in PARTS), ("rate", float)]
)
"""Every part of a servo, and its ticks a second."""

NOBODY: Mapping[str, type[Estimator]] = {}


def describe(servo: Servo) -> Table:
    """The servo as it comes back from JSON: a table."""
    parts = {part: _described(getattr(servo, part), classes) for part, classes in PARTS.items()}
    return json.loads(json.dumps({**parts, "rate": servo.rate}, default=_plain))


def _described(value: Any, classes: Classes) -> object:
    names = [f.name for f in fields(value)] if is_dataclass(value) else []
    return {KIND: name_of(value, classes), **{name: getattr(value, name) for name in names}}


def _plain(value: Any) -> object:
    """Settings within settings as a table; what JSON cannot hold in words."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else repr(value)


def rebuild(description: object, own: Mapping[str, type[Estimator]] = NOBODY) -> Servo:
    """The servo that was described, with the estimators that are the caller's `own` by their names;
    BadInput, naming the field, where that cannot be.
    """
    told: Any = decode(Description, description, "servo")
    parts = {**PARTS, "estimator": {**ESTIMATORS, **own}}
    made = {part: _rebuilt(getattr(told, part), parts[part], f"servo.{part}") for part in parts}
    return Servo(**made, rate=told.rate)


def rebuild_part(description: object, part: str) -> Any:
    """One part of the servo that was described, such as its ``mechanism``, whatever the others
    hold; BadInput where that cannot be.
    """
    table: object = description.get(part) if is_table(description) else None
    return _rebuilt(table, PARTS[part], f"servo.{part}")


def _rebuilt(table: object, classes: Classes, where: str) -> Any:
    """One part, with every one of its settings given: a default may change from version to
    version.
    """
    if not is_table(table):
        raise BadInput(where, table, "a table of settings")
    names = [f.name for f in fields(find_class(classes, table.get(KIND), where))]
    table = with_present_names(table, [KIND, *names])
    for name in names:
        if name not in table:
            raise BadInput(f"{where}.{name}", None, "given")
    return decode_kind(classes, table, where)
