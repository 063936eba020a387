"""Checks of the first values that a device returns, before a motion depends on them."""

from collections.abc import Callable
from numbers import Integral
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import require
from rcmservo.interfaces import Frame, Markers


class Contract(NamedTuple):
    """Values that a method may return.

    Parameters
    ----------
    is_met : Callable[[Any], bool]
        Test of a value.
    expected : str
        Noun phrase for the values that pass the test.
    """

    is_met: Callable[[Any], bool]
    expected: str


def _is_array(value: Any, *shape: int) -> bool:
    """Return True for an array that compiled code accepts unchanged.

    Any other kind would start another compilation, in motion.
    """
    if not isinstance(value, np.ndarray):
        return False
    array = cast(NDArray[Any], value)
    is_float = array.dtype == np.float64 and array.shape == shape
    return is_float and array.flags.c_contiguous and array.flags.writeable


def _is_measured(answer: Any) -> bool:
    if not isinstance(answer, tuple) or len(answer) != 3:  # pyright: ignore[reportUnknownArgumentType]
        return False
    time, q, enabled = answer  # pyright: ignore[reportUnknownVariableType]
    return isinstance(time, Integral) and _is_array(q, 3) and isinstance(enabled, bool | np.bool_)


def _is_rates(answer: Any) -> bool:
    return _is_array(answer, 3)


def _is_frame(answer: Any) -> bool:
    times = ("number", "exposure", "arrival")
    return isinstance(answer, Frame) and all(
        isinstance(getattr(answer, name), Integral) for name in times
    )


def _is_markers(answer: Any) -> bool:
    has_points = isinstance(answer, Markers) and _is_array(answer.points, 2, 2)
    return has_points and _is_array(answer.radius, 2)


ARRAY_PHRASE = "a writable float64 array of shape"
CONTRACTS = {
    "measure": Contract(
        _is_measured,
        f"Measured(time in whole ns, q as {ARRAY_PHRASE} (3,), enabled as True or False)",
    ),
    "apply": Contract(_is_rates, f"the joint rates that it applies, {ARRAY_PHRASE} (3,)"),
    "latest": Contract(_is_frame, "a Frame with its number and times as whole numbers, or None"),
    "find": Contract(
        _is_markers, f"Markers with points as {ARRAY_PHRASE} (2, 2) and radius as one of (2,)"
    ),
}
"""Contract of each method, by its name."""


def check_first_value(device: object, method: str, answer: object) -> None:
    """Raise `BadInput` with the names of device and method if a value breaks the contract."""
    contract = CONTRACTS[method]
    require(
        contract.is_met(answer), f"{type(device).__name__}.{method}()", answer, contract.expected
    )
