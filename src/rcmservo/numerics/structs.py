"""Rows of numbers with names: what compiled functions read and write, and what a batch holds.

A class that derives from `Row` declares its fields once, each with shape, unit and meaning:

    class Estimate(Row):
        o_c: Floats = reals(2, "px", "where the camera sees the RCM")
        condition: float = real("", "condition number of the scaled Ĵ")

A row may have the fields of others, which it derives from, and other rows as parts. Its numbers lie
in a NumPy array of such rows. A compiled function takes the array and reads `rows[0].o_c`; a batch
is a longer array. Outside of compiled functions `Estimate(rows).o_c` is the same number or a view
of it.

What Python code has as a dataclass is not declared a second time for compiled functions: a `Struct`
is a row generated from a dataclass, `as_row` makes a row of settings, and `tuple_struct` a named
tuple of a dataclass whose arrays are passed without a copy.
"""

import collections
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import Enum
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

from rcmservo.numerics.jit import PLAIN

Kind_co = TypeVar("Kind_co", covariant=True)
Kind = TypeVar("Kind", bound="Row")
Settings = TypeVar("Settings")

Floats = NDArray[np.float64]
"""Array of floating-point numbers."""


CODES = {int: "i8", bool: "?", float: "f8"}
"""NumPy's codes of numbers."""


def _dtype(layout: np.dtype[Any]) -> np.dtype[Any]:
    """The layout for compiled functions, or for the same functions as plain Python."""
    return np.dtype((np.record, layout)) if PLAIN else layout


class Rows(Protocol, Generic[Kind_co]):
    """An array of rows, as a compiled function sees it."""

    def __getitem__(self, index: int, /) -> Kind_co: ...

    def copy(self) -> Self: ...


class Field:
    """One number or array of a row: its shape (empty for a number), unit and meaning."""

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


class Member(Field):
    """A member of an enumeration: its position there, as a number."""

    def __init__(self, kind: type[Enum], meaning: str) -> None:
        super().__init__("i8", (), "", meaning)
        self.members = tuple(kind)


class Part(Field):
    """A row that is part of another: a view of it, outside of compiled functions too."""

    def __init__(self, kind: "type[Row]", meaning: str) -> None:
        super().__init__(kind.dtype, (), "", meaning)
        self.kind = kind

    def __get__(self, row: Any, owner: type) -> Any:
        return self if row is None else self.kind(row.rows[self.name])


def part(kind: "type[Kind]", meaning: str) -> Kind:
    """A row of another kind."""
    return cast(Any, Part(kind, meaning))


def real(unit: str, meaning: str) -> Any:
    """A number."""
    return Field("f8", (), unit, meaning)


def reals(shape: int | tuple[int, ...], unit: str, meaning: str) -> Any:
    """An array of numbers."""
    return Field("f8", (shape,) if isinstance(shape, int) else shape, unit, meaning)


def whole(unit: str, meaning: str) -> Any:
    """A whole number."""
    return Field("i8", (), unit, meaning)


def wholes(size: int, unit: str, meaning: str) -> Any:
    """So many whole numbers."""
    return Field("i8", (size,), unit, meaning)


def flag(meaning: str) -> Any:
    """True or False."""
    return Field("?", (), "", meaning)


class Row:
    """One row of numbers with names; ``rows`` is the array, of length 1, that holds it."""

    fields: ClassVar[tuple[Field, ...]]
    dtype: ClassVar[np.dtype[Any]]

    def __init_subclass__(cls) -> None:
        found = (value for base in reversed(cls.__mro__) for value in vars(base).values())
        cls.fields = tuple(value for value in found if isinstance(value, Field))
        layout = np.dtype([(field.name, field.code, field.shape) for field in cls.fields])
        cls.dtype = _dtype(layout)

    def __init__(self, rows: Rows[Self]) -> None:
        self.rows = rows

    @classmethod
    def of(cls, **numbers: Any) -> Self:
        """A row with these numbers; zeros where none is given."""
        table: NDArray[Any] = np.zeros(1, cls.dtype)
        for name, value in numbers.items():
            table[name] = _plain(value)
        return cls(cast(Any, table))


def _plain(value: Any) -> Any:
    """What NumPy puts into a row: of a row its numbers."""
    return value.rows if isinstance(value, Row) else value


def copied(row: Kind) -> Kind:
    """A copy of a row, by its bytes: NumPy takes five times as long, field by field."""
    rows: Any = row.rows
    return type(row)(cast(Any, np.ndarray(1, row.dtype, bytearray(rows.tobytes()))))


def changed(row: Kind, **numbers: Any) -> Kind:
    """A copy of a row with other numbers."""
    other = copied(row)
    for name, value in numbers.items():
        cast(Any, other.rows)[name] = _plain(value)
    return other


class Struct(Row):
    """A row generated from a dataclass, with the same fields under the same names.

    A member of an enumeration becomes its position there. An array is declared with its shape, as
    in ``Annotated[Floats, (3,)]``. Fields that are no numbers, such as words, are left out, and
    those named in `without`.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

        def __setattr__(self, name: str, value: Any) -> None: ...

    def __init_subclass__(cls, source: type[Any], without: tuple[str, ...] = ()) -> None:
        hints = get_type_hints(source, include_extras=True)
        for name in (name for name in _names(source) if name not in without):
            made = _generated(hints[name], f"{name} of {source.__name__}")
            if made is not None:
                setattr(cls, name, made)
                made.__set_name__(cls, name)
        super().__init_subclass__()

    @classmethod
    def from_source(cls, value: Any) -> Self:
        """The numbers of an instance of the dataclass."""
        numbers = {field.name: getattr(value, field.name) for field in cls.fields}
        for field in cls.fields:
            if isinstance(field, Member):
                numbers[field.name] = field.members.index(numbers[field.name])
        return cls.of(**numbers)

    def values(self) -> dict[str, Any]:
        """The dataclass's fields by name, to make an instance of it."""
        values = {field.name: getattr(self, field.name) for field in self.fields}
        for field in self.fields:
            if isinstance(field, Member):
                values[field.name] = field.members[values[field.name]]
            elif field.shape:
                values[field.name] = values[field.name].copy()
        return values


def _generated(hint: Any, meaning: str) -> Field | None:
    """The field for a type hint; None where it is no number."""
    if get_origin(hint) is Annotated:
        return Field("f8", get_args(hint)[1], "", meaning)
    if issubclass(hint, Enum):
        return Member(hint, meaning)
    return Field(CODES[hint], (), "", meaning) if hint in CODES else None


def tuple_struct(source: type[Any], without: tuple[str, ...] = ()) -> Any:
    """Generate a named tuple of a dataclass's fields, for compiled functions."""
    names = [name for name in _names(source) if name not in without]
    made = cast(Any, collections).namedtuple(f"{source.__name__}Struct", names)
    made.__module__ = source.__module__
    return made


def struct_reader(source: type[Any], struct: Any) -> Callable[[Any], tuple[Any, ...]]:
    """Return the function that reads the fields of a named tuple off an instance of its dataclass.

    It gives a plain tuple: that passes to compiled functions in a third of the time.
    """
    hints = get_type_hints(source)
    coded = {name for name, hint in hints.items() if isinstance(hint, type(Enum))}
    names = _names(struct)
    return cast(Any, attrgetter(*(f"{name}._value_" if name in coded else name for name in names)))


def _names(source: type[Any]) -> tuple[str, ...]:
    """The fields of a dataclass or named tuple."""
    if is_dataclass(source):
        return tuple(one.name for one in fields(source))
    return cast(Any, source)._fields


def as_row(settings: Settings) -> Rows[Settings]:
    """A dataclass or named tuple of numbers as an array of one row, its fields under their own
    names; of rows and such classes too, which become parts. Words are left out.
    """
    kind = type(settings)
    hints = get_type_hints(kind)
    values = {name: getattr(settings, name) for name in _names(kind)}
    table = {name: _setting(one) for name, one in values.items() if not isinstance(one, str)}
    layout = np.dtype([(name, *_place(hints[name], value)) for name, value in table.items()])
    rows: NDArray[Any] = np.zeros(1, _dtype(layout))
    for name, value in table.items():
        rows[name] = value
    return cast(Any, rows)


def _setting(value: Any) -> Any:
    """One setting as NumPy takes it."""
    return as_row(value) if is_dataclass(value) or hasattr(value, "_fields") else _plain(value)


def _place(hint: Any, value: Any) -> tuple[Any, tuple[int, ...]]:
    """Kind and shape of the field for a setting."""
    kind = getattr(value, "dtype", None)
    return (CODES.get(hint, "f8"), np.shape(value)) if kind is None else (kind, ())
