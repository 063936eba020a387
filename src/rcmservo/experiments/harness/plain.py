"""Dataclasses to plain JSON and back, by the types of their fields.

A single number must be finite: NaN is a measurement that failed. An array or a series may have
gaps, which are null in JSON and NaN in memory.
"""

import math
import types
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from rcmservo.config.texts import is_table
from rcmservo.experiments.harness.claims import NotMeasured

Kind = TypeVar("Kind")


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
    """A value of this kind from what JSON holds of it."""
    return _built(kind, value)


def _built(kind: Any, value: Any) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        (only,) = [one for one in inner if one is not type(None)]
        return None if value is None else _built(only, value)
    if origin is np.ndarray:
        return np.array(value, dtype=float)
    if origin is dict:
        return {name: _built(inner[1], one) for name, one in value.items()}
    if origin is list:
        return [_built(inner[0], one) for one in value]
    if origin is tuple:
        return _tuple(inner, value)
    return _dataclass(kind, value) if is_dataclass(kind) else kind(value)


def _tuple(inner: Sequence[Any], value: Any) -> tuple[Any, ...]:
    kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
    return tuple(_built(kind, one) for kind, one in zip(kinds, value, strict=True))


def _dataclass(kind: Any, value: Any) -> Any:
    hints = get_type_hints(kind)
    return kind(
        **{field.name: _built(hints[field.name], value[field.name]) for field in fields(kind)}
    )
