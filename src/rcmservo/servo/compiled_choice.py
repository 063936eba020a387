"""The choice among compiled_ones.py in compiled functions, by the type of the memory. It imports
Numba, so nothing imports it before a kernel is compiled."""

from functools import partial
from typing import Any

from numba.core import types
from numba.extending import overload

from rcmservo.servo.compiled_ones import EMPTIED, LEARNED, emptied, learned
from rcmservo.servo.state import Beside

declared: Any = partial(overload, strict=False)


def _kind(beside: Any) -> type[Any]:
    """The kind of memory that a type of Numba's stands for."""
    return Beside if isinstance(beside, types.NamedTuple) else tuple


@declared(learned)
def _learned(kept: Any, beside: Any, seen: Any, target: Any, dt: Any, rule: Any, fixed: Any) -> Any:
    return LEARNED[_kind(beside)].py_func  # pyright: ignore[reportFunctionMemberAccess]


@declared(emptied)
def _emptied(beside: Any) -> Any:
    return EMPTIED[_kind(beside)].py_func  # pyright: ignore[reportFunctionMemberAccess]
