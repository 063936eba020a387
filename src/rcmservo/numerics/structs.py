"""Structs with named fields, which compiled functions and Python code read and write alike.

A class that derives from `Row` declares its fields once, each with shape, unit and meaning:

    class Estimate(Row):
        o_c: Floats = reals(2, "px", "imaged RCM")
        condition: float = real("", "condition number of the scaled Ĵ")

A row inherits the fields of its base classes and may contain other rows as parts. Its numbers are
in a NumPy structured array. A compiled function takes the array and reads `rows[0].o_c`; a batch is
a longer array. In Python code, `Estimate(rows).o_c` is the same number or a view of it.

Dataclasses are not declared a second time for compiled functions: `Struct` generates a row from a
dataclass, `to_row` makes a row of settings, and `make_tuple_struct` makes a named tuple of a
dataclass whose arrays are passed without a copy.
"""

import collections
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from operator import attrgetter
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    Protocol,
    Self,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from rcmservo.numerics.jit import JIT_IS_DISABLED

RowType_co = TypeVar("RowType_co", covariant=True)
RowType = TypeVar("RowType", bound="Row")
Settings = TypeVar("Settings")

Floats = NDArray[np.float64]
"""Array of floating-point numbers."""


NUMPY_CODES = {int: "i8", bool: "?", float: "f8"}
"""NumPy's codes of the number types."""


@cache
def _make_dtype(layout: np.dtype[Any]) -> np.dtype[Any]:
    """Return a layout for compiled functions, or for the same functions as plain Python.

    Equal layouts give the same object. Numba would compare another one field by field at each call,
    which takes 4 us for a tick.
    """
    return np.dtype((np.record, layout)) if JIT_IS_DISABLED else layout


class Rows(Protocol, Generic[RowType_co]):
    """Array of rows, as a compiled function indexes it."""

    def __getitem__(self, index: int, /) -> RowType_co: ...

    def copy(self) -> Self: ...


class Field:
    """Field of a row, one number or array: its shape (empty for a number), unit and meaning."""

    def __init__(self, code: Any, shape: tuple[int, ...], unit: str, meaning: str) -> None:
        self.code, self.shape, self.unit, self.meaning = code, shape, unit, meaning
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, row: Any, owner: type) -> Any:
        if row is None:
            return self
        value = row.rows[self.name][0]
        return value if self.shape else value.item()


class EnumField(Field):
    """Field that holds a member of an enumeration as its position there."""

    def __init__(self, kind: type[Enum], meaning: str) -> None:
        super().__init__("i8", (), "", meaning)
        self.members = tuple(kind)


class RowField(Field):
    """Field that holds another row; in Python code it is a view of that row."""

    def __init__(self, kind: "type[Row]", meaning: str) -> None:
        super().__init__(kind.dtype, (), "", meaning)
        self.kind = kind

    def __get__(self, row: Any, owner: type) -> Any:
        return self if row is None else self.kind(row.rows[self.name])


def part(kind: "type[RowType]", meaning: str) -> RowType:
    """Declare a field that is a row of another kind."""
    return cast(Any, RowField(kind, meaning))


def real(unit: str, meaning: str) -> Any:
    """Declare a field that is a floating-point number."""
    return Field("f8", (), unit, meaning)


def reals(shape: int | tuple[int, ...], unit: str, meaning: str) -> Any:
    """Declare a field that is an array of floating-point numbers."""
    return Field("f8", (shape,) if isinstance(shape, int) else shape, unit, meaning)


def whole(unit: str, meaning: str) -> Any:
    """Declare a field that is an integer."""
    return Field("i8", (), unit, meaning)


def wholes(size: int, unit: str, meaning: str) -> Any:
    """Declare a field that is an array of `size` integers."""
    return Field("i8", (size,), unit, meaning)


def flag(meaning: str) -> Any:
    """Declare a field that is True or False."""
    return Field("?", (), "", meaning)


class Row:
    """Base of structs with named fields; ``rows`` is the array of length 1 with the numbers."""

    fields: ClassVar[tuple[Field, ...]]
    dtype: ClassVar[np.dtype[Any]]

    def __init_subclass__(cls) -> None:
        attributes = (value for base in reversed(cls.__mro__) for value in vars(base).values())
        cls.fields = tuple(value for value in attributes if isinstance(value, Field))
        layout = np.dtype([(field.name, field.code, field.shape) for field in cls.fields])
        cls.dtype = _make_dtype(layout)

    def __init__(self, rows: Rows[Self]) -> None:
        self.rows = rows

    @classmethod
    def of(cls, **numbers: Any) -> Self:
        """Return a row with these field values, and zeros for the other fields."""
        array: NDArray[Any] = np.zeros(1, cls.dtype)
        for name, value in numbers.items():
            array[name] = _to_array(value)
        return cls(cast(Any, array))


def _to_array(value: Any) -> Any:
    """Return the array of a row, and any other value unchanged."""
    return value.rows if isinstance(value, Row) else value


def copy_row(row: RowType) -> RowType:
    """Return a copy of a row.

    It is made from the row's bytes: NumPy's copy, field by field, takes five times as long.
    """
    rows: Any = row.rows
    return type(row)(cast(Any, np.ndarray(1, row.dtype, bytearray(rows.tobytes()))))


def replace_fields(row: RowType, **numbers: Any) -> RowType:
    """Return a copy of a row with new values of some fields."""
    copy = copy_row(row)
    for name, value in numbers.items():
        cast(Any, copy.rows)[name] = _to_array(value)
    return copy


class Struct(Row):
    """Row generated from a dataclass, with the same fields under the same names.

    A member of an enumeration becomes its position there. An array is declared with its shape, as
    in ``Annotated[Floats, (3,)]``. Fields without a number, such as texts, and those named in
    `without` are left out.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

        def __setattr__(self, name: str, value: Any) -> None: ...

    def __init_subclass__(cls, source: type[Any], without: tuple[str, ...] = ()) -> None:
        hints = get_type_hints(source, include_extras=True)
        for name in (name for name in _list_field_names(source) if name not in without):
            new_field = _make_field(hints[name], f"{name} of {source.__name__}")
            if new_field is not None:
                setattr(cls, name, new_field)
                new_field.__set_name__(cls, name)
        super().__init_subclass__()

    @classmethod
    def from_source(cls, value: Any) -> Self:
        """Return the row of an instance of the dataclass."""
        numbers = {field.name: getattr(value, field.name) for field in cls.fields}
        for field in cls.fields:
            if isinstance(field, EnumField):
                numbers[field.name] = field.members.index(numbers[field.name])
        return cls.of(**numbers)

    def values(self) -> dict[str, Any]:
        """Return the fields of the dataclass by name, as its constructor takes them."""
        values = {field.name: getattr(self, field.name) for field in self.fields}
        for field in self.fields:
            if isinstance(field, EnumField):
                values[field.name] = field.members[values[field.name]]
            elif field.shape:
                values[field.name] = values[field.name].copy()
        return values


def _make_field(hint: Any, meaning: str) -> Field | None:
    """Return the field for a type hint; None if the hint is not a number."""
    if get_origin(hint) is Annotated:
        return Field("f8", get_args(hint)[1], "", meaning)
    if issubclass(hint, Enum):
        return EnumField(hint, meaning)
    return Field(NUMPY_CODES[hint], (), "", meaning) if hint in NUMPY_CODES else None


def make_tuple_struct(source: type[Any], without: tuple[str, ...] = ()) -> Any:
    """Return a named tuple type with a dataclass's fields, for compiled functions."""
    names = [name for name in _list_field_names(source) if name not in without]
    tuple_type = cast(Any, collections).namedtuple(f"{source.__name__}Struct", names)
    tuple_type.__module__ = source.__module__
    return tuple_type


def make_struct_reader(source: type[Any], struct: Any) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that reads the fields of a named tuple from an instance of its dataclass.

    That function returns a plain tuple, which passes to compiled functions in a third of the time.
    """
    hints = get_type_hints(source)
    enums = {name for name, hint in hints.items() if isinstance(hint, type(Enum))}
    names = _list_field_names(struct)
    return cast(Any, attrgetter(*(f"{name}._value_" if name in enums else name for name in names)))


def _list_field_names(source: type[Any]) -> tuple[str, ...]:
    """Return the names of the fields of a dataclass or named tuple."""
    if is_dataclass(source):
        return tuple(field.name for field in fields(source))
    return cast(Any, source)._fields


def to_row(settings: Settings) -> Rows[Settings]:
    """Return a dataclass or named tuple of numbers as an array of one row.

    The fields keep their names. Fields that are rows, dataclasses or named tuples become parts.
    Texts are left out.
    """
    hints = get_type_hints(type(settings))
    numbers: dict[str, Any] = {}
    layout: list[tuple[str, Any, tuple[int, ...]]] = []
    for name in _list_field_names(type(settings)):
        value = getattr(settings, name)
        if isinstance(value, str):
            continue
        is_struct = is_dataclass(value) or hasattr(value, "_fields")
        number: Any = to_row(value) if is_struct else _to_array(value)
        numbers[name] = number
        if hasattr(number, "dtype"):
            layout.append((name, number.dtype, ()))
        else:
            layout.append((name, NUMPY_CODES.get(hints[name], "f8"), np.shape(number)))
    rows: NDArray[Any] = np.zeros(1, _make_dtype(np.dtype(layout)))
    for name, number in numbers.items():
        rows[name] = number
    return cast(Any, rows)
