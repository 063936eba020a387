"""Checks of the first values that a device returns, before a motion depends on them."""

from collections.abc import Callable
from numbers import Integral
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import require
from rcmservo.interfaces import Frame, Markers

ARRAY_PHRASE = "a writable float64 array in C order of shape"


def check_first_value(device: object, method: str, value: object) -> None:
    """Raise `BadInput` with the names of device and method unless a returned value is valid."""
    is_valid, expected = CONTRACTS[method]
    require(is_valid(value), f"{type(device).__name__}.{method}()", value, expected)


def _is_array(value: Any, *shape: int) -> bool:
    """Return True for an array that compiled code accepts unchanged.

    For any other kind of array Numba would compile the code again, during a motion.
    """
    if not isinstance(value, np.ndarray):
        return False
    array = cast(NDArray[Any], value)
    is_float = array.dtype == np.float64 and array.shape == shape
    return is_float and array.flags.c_contiguous and array.flags.writeable


def _is_measurement(value: Any) -> bool:
    if not isinstance(value, tuple) or len(value) != 3:  # pyright: ignore[reportUnknownArgumentType]
        return False
    time, q, enabled = value  # pyright: ignore[reportUnknownVariableType]
    return isinstance(time, Integral) and _is_array(q, 3) and isinstance(enabled, bool | np.bool_)


def _is_frame(value: Any) -> bool:
    return isinstance(value, Frame) and all(
        isinstance(number, Integral) for number in (value.number, value.exposure, value.arrival)
    )


def _is_markers(value: Any) -> bool:
    has_points = isinstance(value, Markers) and _is_array(value.points, 2, 2)
    return has_points and _is_array(value.radius, 2)


CONTRACTS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "measure": (
        _is_measurement,
        f"ArmMeasurement(time in whole ns, q as {ARRAY_PHRASE} (3,), enabled as True or False)",
    ),
    "apply": (
        lambda value: _is_array(value, 3),
        f"the joint rates that it applies, {ARRAY_PHRASE} (3,)",
    ),
    "latest": (_is_frame, "a Frame with its number and times as whole numbers, or None"),
    "find": (
        _is_markers,
        f"Markers with points as {ARRAY_PHRASE} (2, 2) and radius as one of (2,)",
    ),
}
"""Test of the value that a method returns, and noun phrase for the valid values, by method."""
