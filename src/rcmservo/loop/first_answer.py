"""What a device answers at its first call, looked at before a motion relies on it."""

from collections.abc import Callable
from numbers import Integral
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rcmservo.errors import require
from rcmservo.interfaces import Frame, Markers


class Right(NamedTuple):
    """What a method should answer."""

    good: Callable[[Any], bool]
    """Whether an answer is right."""
    words: str
    """The same in words: what an answer must be."""


def _array(value: Any, *shape: int) -> bool:
    """Whether it is an array that compiled code takes as it is: any other kind would make it
    compile anew, in motion."""
    if not isinstance(value, np.ndarray):
        return False
    array = cast(NDArray[Any], value)
    usual = array.dtype == np.float64 and array.shape == shape
    return usual and array.flags.c_contiguous and array.flags.writeable


def _measured(answer: Any) -> bool:
    if not isinstance(answer, tuple) or len(answer) != 3:  # pyright: ignore[reportUnknownArgumentType]
        return False
    time, q, enabled = answer  # pyright: ignore[reportUnknownVariableType]
    return isinstance(time, Integral) and _array(q, 3) and isinstance(enabled, bool | np.bool_)


def _rates(answer: Any) -> bool:
    return _array(answer, 3)


def _frame(answer: Any) -> bool:
    times = ("number", "exposure", "arrival")
    return isinstance(answer, Frame) and all(
        isinstance(getattr(answer, name), Integral) for name in times
    )


def _markers(answer: Any) -> bool:
    good = isinstance(answer, Markers) and _array(answer.points, 2, 2)
    return good and _array(answer.radius, 2)


ARRAY = "a writable float64 array of shape"
RIGHT = {
    "measure": Right(
        _measured, f"Measured(time in whole ns, q as {ARRAY} (3,), enabled as True or False)"
    ),
    "apply": Right(_rates, f"the joint rates it takes, {ARRAY} (3,)"),
    "latest": Right(_frame, "a Frame with its number and times as whole numbers, or None"),
    "find": Right(_markers, f"Markers with points as {ARRAY} (2, 2) and radius as one of (2,)"),
}
"""By the method's name."""


def look_at(device: object, method: str, answer: object) -> None:
    """Raise BadInput, in a sentence that names device and method, where an answer is not right."""
    right = RIGHT[method]
    require(right.good(answer), f"{type(device).__name__}.{method}()", answer, right.words)
