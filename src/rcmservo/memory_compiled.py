"""The compiled form of the functions in memory.py: arrays on the stack, and arrays whose references
are not counted. It imports Numba, so nothing imports it before a kernel is compiled."""

from functools import partial
from math import prod
from typing import Any, cast

from numba import extending
from numba.core import cgutils
from numba.core import types as numba_types
from numba.np import arrayobj

from rcmservo.memory import scratch, scratch_table, unowned

arrays, tools, types = cast(tuple[Any, Any, Any], (arrayobj, cgutils, numba_types))
intrinsic: Any = extending.intrinsic
declared: Any = partial(extending.overload, strict=False, prefer_literal=True)


@intrinsic
def _line(typing: Any, n: Any) -> Any:
    return _room(n)


@intrinsic
def _table(typing: Any, n: Any, m: Any) -> Any:
    return _room(n, m)


def _room(*shape: Any) -> Any:
    """What Numba puts where an array of this shape on the stack is asked for."""
    if not all(isinstance(n, types.IntegerLiteral) for n in shape):
        return None  # it asks again with the numbers themselves
    sizes: list[int] = [n.literal_value for n in shape]
    kind = types.Array(types.float64, len(shape), "C")

    def code(context: Any, builder: Any, *_: Any) -> Any:
        whole, real = context.get_value_type(types.intp), context.get_data_type(types.float64)
        room = tools.alloca_once(builder, real, whole(prod(sizes)))
        along = [whole(size) for size in sizes]
        strides = [whole(8 * prod(sizes[k + 1 :])) for k in range(len(sizes))]
        array = arrays.make_array(kind)(context, builder)
        arrays.populate_array(array, room, along, strides, itemsize=whole(8), meminfo=None)
        return array._getvalue()

    return kind(*shape), code


@intrinsic
def _uncounted(typing: Any, things: Any) -> Any:
    def code(context: Any, builder: Any, _: Any, given: Any) -> Any:
        return _without_owner(context, builder, things, given[0])

    return things(things), code


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The value without what counts its references."""
    if isinstance(kind, types.Array):
        array = arrays.make_array(kind)(context, builder, value)
        array.meminfo = tools.get_null_value(array.meminfo.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind.types):
            inner = _without_owner(context, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, inner, k)
    return value


@declared(scratch)
def _scratch(n: Any) -> Any:
    def called(n: Any) -> Any:
        return _line(n)

    return called


@declared(scratch_table)
def _scratch_table(n: Any, m: Any) -> Any:
    def called(n: Any, m: Any) -> Any:
        return _table(n, m)

    return called


@declared(unowned)
def _unowned(things: Any) -> Any:
    def called(things: Any) -> Any:
        return _uncounted(things)

    return called
