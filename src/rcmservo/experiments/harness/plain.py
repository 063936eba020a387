"""Dataclasses to plain JSON, and back by the types of their fields.

A single number must be finite: NaN is a measurement that failed. An array or a series may have
gaps, which are null in JSON and NaN in memory.
"""

import math
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from pydantic import PlainValidator, TypeAdapter

from rcmservo.config.texts import is_table
from rcmservo.experiments.harness.claims import NotMeasured
from rcmservo.interfaces import Floats

Kind = TypeVar("Kind")


def _array(values: Any) -> Floats:
    return np.array(values, dtype=float)


JsonFloats = Annotated[Floats, PlainValidator(_array)]
"""Type of a dataclass's field with an array of numbers, which JSON holds as nested lists."""


def plain(value: Any, where: str = "result") -> Any:
    """What JSON holds of a value; NotMeasured, naming the field, for a number not finite."""
    if is_dataclass(value):
        names = [field.name for field in fields(value)]
        return {name: plain(getattr(value, name), f"{where}.{name}") for name in names}
    if is_table(value):
        return {name: plain(one, f"{where}.{name}") for name, one in value.items()}
    if isinstance(value, np.ndarray):
        return _gaps(cast(Any, value).tolist())
    if isinstance(value, list | tuple):
        return [plain(one, f"{where}[{i}]") for i, one in enumerate(cast(Sequence[Any], value))]
    return _scalar(value, where)


def _scalar(value: Any, where: str) -> Any:
    number = cast(Any, value).item() if isinstance(value, np.generic) else value
    if isinstance(number, float) and not math.isfinite(number):
        raise NotMeasured(where, number)
    return number


def _gaps(values: Any) -> Any:
    if isinstance(values, list):
        return [_gaps(one) for one in cast(list[Any], values)]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def built(kind: type[Kind], value: Any) -> Kind:
    """Return a value of this kind from its form in JSON."""
    return TypeAdapter(kind).validate_python(value)
