"""Conversion of a servo to JSON and back. A record stores the servo in this form for its replay.

    {"mechanism": {"kind": "spherical", "limits": {…}, …}, "tool": {"kind": "rigid", …}, …, "rate":
    100.0}

The numbers survive bit for bit. A user-defined estimator is stored as module:class with its
settings. It is restored only if the caller passes its class.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, make_dataclass
from typing import Any

from rcmservo.config.class_registry import (
    ESTIMATORS,
    KIND_KEY,
    PART_CLASSES,
    Classes,
    decode_kind,
    find_class,
    find_class_name,
)
from rcmservo.config.former_names import replace_former_names
from rcmservo.config.strict_decoding import decode_settings
from rcmservo.config.toml_json_parsing import Table, is_table
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Estimator
from rcmservo.servo.servo import Servo

ServoDescription: type[object] = make_dataclass(
    "ServoDescription", [*((part, object) for part in PART_CLASSES), ("rate", float)]
)
"""Parts of a servo as tables, and its tick rate in Hz."""

NO_USER_ESTIMATORS: Mapping[str, type[Estimator]] = {}
"""No user-defined estimators."""


def describe_servo(servo: Servo) -> Table:
    """Return a servo as a table of JSON values."""
    parts = {
        part: _describe_part(getattr(servo, part), classes)
        for part, classes in PART_CLASSES.items()
    }
    return json.loads(json.dumps({**parts, "rate": servo.rate}, default=_convert_to_json))


def _describe_part(part: Any, classes: Classes) -> Table:
    """Return the settings of a part of a servo and the name of its class."""
    settings = {f.name: getattr(part, f.name) for f in fields(part)} if is_dataclass(part) else {}
    return {KIND_KEY: find_class_name(part, classes), **settings}


def _convert_to_json(value: Any) -> object:
    """Return nested settings as a table, and any other value as its `repr`."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else repr(value)


def rebuild_servo(
    description: object, user_estimators: Mapping[str, type[Estimator]] = NO_USER_ESTIMATORS
) -> Servo:
    """Return the servo that a description contains.

    Parameters
    ----------
    description : object
        Result of `describe_servo`, or JSON values of a record.
    user_estimators : Mapping[str, type[Estimator]]
        Permitted user-defined estimators by name.

    Returns
    -------
    Servo
        Servo with the described settings, and no defaults.

    Raises
    ------
    BadInput
        If a field is missing, unknown or invalid; the error names it.
    """
    tables: Any = decode_settings(ServoDescription, description, "servo")
    classes = {**PART_CLASSES, "estimator": {**ESTIMATORS, **user_estimators}}
    parts = {p: _rebuild_part(getattr(tables, p), classes[p], f"servo.{p}") for p in classes}
    return Servo(**parts, rate=tables.rate)


def rebuild_part(description: object, part: str) -> Any:
    """Return one part of a described servo, such as its ``mechanism``; ignore the other parts.

    Raises
    ------
    BadInput
        If the part is missing or invalid.
    """
    table: object = description.get(part) if is_table(description) else None
    return _rebuild_part(table, PART_CLASSES[part], f"servo.{part}")


def _rebuild_part(table: object, classes: Classes, path: str) -> Any:
    """Return the part in a table, which must give all settings, since defaults may change."""
    if not is_table(table):
        raise BadInput(path, table, "a table of settings")
    names = [f.name for f in fields(find_class(classes, table.get(KIND_KEY), path))]
    table = replace_former_names(table, [KIND_KEY, *names])
    for name in names:
        if name not in table:
            raise BadInput(f"{path}.{name}", None, "given")
    return decode_kind(classes, table, path)
