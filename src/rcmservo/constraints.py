"""Limits of settings, declared as annotations of dataclass fields and checked at construction.

The class below refuses ``gain=-1`` and ``gain="fast"`` with the error `BadInput` and the message
"controller.gain must be a positive gain in 1/s, got -1":

    @dataclass(frozen=True)
    class SaturatedController(Checked, section="controller"):
        gain: Annotated[float, positive("gain in 1/s")] = 8.0

The classes are plain dataclasses, and pydantic reads them from files. They are not pydantic's own
dataclasses, because importing pydantic and building a schema of each class would add 0.2 s to the
0.3 s of ``import rcmservo``.
"""

import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, fields
from functools import cache
from numbers import Real
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from rcmservo.errors import BadInput, suggest_name

Triple = tuple[float, float, float]
"""Three numbers, for example one for each joint."""

COUNT_WORDS = {2: "two", 3: "three"}
"""Counts that messages spell as words."""


@dataclass(frozen=True)
class Limit:
    """Condition that a value must meet, as metadata of ``Annotated``.

    Parameters
    ----------
    holds : Callable[[Any], bool]
        Test of a value of the expected type. NaN fails it.
    expected : str
        Noun phrase for the values that meet the condition.
    hint : Callable[[Any], str]
        Text that follows `expected` in the message, made from the refused value.
    """

    holds: Callable[[Any], bool]
    expected: str
    hint: Callable[[Any], str] = field(default=lambda value: "")

    def __repr__(self) -> str:
        """Return the expected values, as `help` shows them in signatures."""
        return f"<{self.expected}>"

    def require(self, name: str, value: Any) -> None:
        """Raise ``BadInput`` for the field or argument `name` unless its value is valid."""
        try:
            is_met = self.holds(value)
        except (TypeError, ValueError):  # a value of another type, which cannot be compared
            is_met = False
        if not is_met:
            raise BadInput(name, value, self.expected + self.hint(value))


def _format_number(number: float) -> str:
    """Return a number in its shortest exact form: 0.1, 16000, 1e-9."""
    text = f"{number:g}"
    exact = text if float(text) == number else f"{number:.10g}"
    return re.sub(r"e\+?(-?)0*", r"e\1", exact)


def positive(what: str = "number") -> Limit:
    """Return the limit to finite numbers above 0; `what` is a noun, such as "gain in 1/s"."""
    return Limit(lambda x: 0.0 < x < math.inf, f"a positive {what}")


def not_negative(what: str = "number") -> Limit:
    """Return the limit to finite numbers of at least 0."""
    return Limit(lambda x: 0.0 <= x < math.inf, f"a {what} that is not negative")


def finite(what: str = "number") -> Limit:
    """Return the limit to finite numbers."""
    return Limit(math.isfinite, f"a finite {what}")


def between(low: float, high: float, what: str = "a number", unit: str = "") -> Limit:
    """Return the limit to numbers from `low` to `high`, both included."""
    expected = f"{what} from {_format_number(low)} to {_format_number(high)} {unit}"
    return Limit(lambda x: low <= x <= high, expected.strip())


def above(low: float, high: float = math.inf, what: str = "a number", unit: str = "") -> Limit:
    """Return the limit to finite numbers above `low` and at most `high`."""
    upper_bound = f" and at most {_format_number(high)}" if high < math.inf else ""
    expected = f"{what} above {_format_number(low)}{upper_bound} {unit}"
    return Limit(lambda x: low < x <= high and x < math.inf, expected.strip())


def inside(low: float, high: float, what: str = "a number") -> Limit:
    """Return the limit to numbers between `low` and `high`, both excluded."""
    expected = f"{what} above {_format_number(low)} and below {_format_number(high)}"
    return Limit(lambda x: low < x < high, expected)


def at_least(low: float, what: str) -> Limit:
    """Return the limit to finite numbers of at least `low`."""
    return Limit(lambda x: low <= x < math.inf, f"at least {_format_number(low)} {what}")


def at_most(high: float, what: str) -> Limit:
    """Return the limit to numbers of at most `high`."""
    return Limit(lambda x: x <= high, f"at most {_format_number(high)} {what}")


FRACTION = above(0.0, 1.0, "a fraction")
"""Limit to numbers above 0 and at most 1."""


def each(limit: Limit, expected: str) -> Limit:
    """Return the limit of a tuple whose entries all meet `limit`."""
    return Limit(lambda values: all(map(limit.holds, values)), expected)


def array(*shape: int) -> Limit:
    """Return the limit to arrays, or nested lists, of finite numbers in a shape."""

    def has_shape_and_is_finite(values: object) -> bool:
        try:
            numbers = np.asarray(values, np.float64)
        except (TypeError, ValueError, OverflowError):
            return False
        return numbers.shape == shape and bool(np.isfinite(numbers).all())

    count = COUNT_WORDS.get(shape[0], shape) if len(shape) == 1 else shape
    return Limit(has_shape_and_is_finite, f"{count} finite numbers")


def three_positive(units: str) -> Limit:
    """Return the limit to three finite numbers above 0, with their units."""
    return each(positive(), f"three positive numbers ({units})")


def angles(maximum: float, first: int, unit: str = "rad") -> Limit:
    """Return the limit of the first `first` entries of a tuple to ± `maximum` rad (or rad/s).

    A larger angle was probably given in degrees, so the message names both units.
    """

    def suggest_degrees(values: Collection[float]) -> str:
        degree_unit, angle = unit.replace("rad", "deg"), max(map(abs, tuple(values)[:first]))
        return (
            f" (did you mean {math.radians(angle):.4g} {unit}, which is {angle:g} {degree_unit}?)"
        )

    expected = f"at most {maximum:.4g} {unit} where it is an angle"
    return Limit(
        lambda values: all(abs(angle) <= maximum for angle in tuple(values)[:first]),
        expected,
        suggest_degrees,
    )


@dataclass(frozen=True, repr=False)
class OneOf(Limit):
    """Limit to some words, such as the names of a registry, to which users may add.

    Parameters
    ----------
    choices : Collection[str]
        Valid words.
    """

    choices: Collection[str] = field(default=(), hash=False)

    def __repr__(self) -> str:
        """Return the present choices, as `help` shows them in signatures."""
        return f"<{self.expected}{', '.join(self.choices)}>"


def one_of(choices: Collection[str]) -> OneOf:
    """Return the limit to some words; the message lists them and suggests the most similar one."""

    def list_words(word: object) -> str:
        return ", ".join(choices) + suggest_name(word, choices)

    return OneOf(lambda word: word in choices, "one of ", list_words, choices)


def find_choices(hint: Any) -> tuple[str, ...]:
    """Return the words that the type of a setting allows; empty for another type."""
    inner, metadata = _split_annotation(hint)
    for limit in metadata:
        if isinstance(limit, OneOf):
            return tuple(limit.choices)
    return get_args(inner) if get_origin(inner) is Literal else ()


def matching(pattern: str, expected: str) -> Limit:
    """Return the limit to texts that a regular expression matches completely."""
    expression = re.compile(pattern, re.ASCII)
    return Limit(lambda text: expression.fullmatch(text) is not None, expected)


def not_empty(expected: str) -> Limit:
    """Return the limit to texts that are not blank, or to collections that are not empty."""
    return Limit(lambda x: bool(x.strip() if isinstance(x, str) else x), expected)


class Checked:
    """Base of frozen dataclasses that check the types and limits of their fields.

    A subclass with rules between fields checks them in ``__post_init__``, after
    ``super().__post_init__()``. The limits of a field that is None are not checked. A class defined
    in a function, whose annotations name types of that function, is not checked at all.

    Raises
    ------
    BadInput
        At construction, with the field, its value and the expected value.
    """

    __slots__ = ()
    section: ClassVar[str] = ""
    """Name of the class in files and messages; subclasses inherit it."""

    def __init_subclass__(cls, section: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if section is not None:
            cls.section = section

    def __post_init__(self) -> None:
        """Raise ``BadInput`` for the first field that violates its annotation."""
        for name, type_limit, limits in _collect_rules(type(self)):
            value = getattr(self, name)
            applicable_limits = () if value is None else limits
            for limit in (type_limit, *applicable_limits):
                if not limit.holds(value):
                    self.require(False, name, limit.expected + limit.hint(value))

    def require(self, condition: object, name: str, expected: str) -> None:
        """Raise ``BadInput`` for the field `name` unless `condition` is true.

        Write the condition so that NaN makes it false.
        """
        if not condition:
            path = f"{self.section}.{name}" if self.section else name
            raise BadInput(path, getattr(self, name), expected)


@cache
def _collect_rules(cls: type[Any]) -> tuple[tuple[str, Limit, tuple[Limit, ...]], ...]:
    """Return name, limit to the type, and further limits of each field."""
    try:
        hints = get_type_hints(cls, include_extras=True)
    except NameError:  # a class defined in a function, whose annotations cannot be resolved here
        return ()
    return tuple((setting.name, *_make_rule(hints[setting.name])) for setting in fields(cls))


def _make_rule(annotation: Any) -> tuple[Limit, tuple[Limit, ...]]:
    """Return the limit to the type of a field, and its further limits.

    A value of another type is refused in the words of the first further limit, which says more.
    """
    hint, metadata = _split_annotation(annotation)
    type_limit = _make_type_limit(hint)
    limits = tuple(entry for entry in metadata if isinstance(entry, Limit))
    shown = limits[0] if limits else type_limit
    suggest = shown.hint if isinstance(shown, OneOf) else type_limit.hint
    return Limit(type_limit.holds, shown.expected, suggest), limits


def _split_annotation(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the type and the metadata of an annotation, which may be ``Annotated``."""
    if get_origin(annotation) is not Annotated:
        return annotation, ()
    hint, *metadata = get_args(annotation)
    return hint, tuple(metadata)


def _is_number(value: object) -> bool:
    """Return True for a real number, not a flag, that a float can hold."""
    if type(value) is float:
        return True
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


ANY_VALUE = Limit(lambda value: True, "any value")

TYPE_LIMITS: dict[Any, Limit] = {
    float: Limit(_is_number, "a number"),
    int: Limit(_is_whole, "a whole number"),
    bool: Limit(lambda value: isinstance(value, bool | np.bool), "true or false"),
    str: Limit(lambda value: isinstance(value, str), "text"),
    NoneType: Limit(lambda value: value is None, "left out"),
    np.ndarray: ANY_VALUE,
}
"""Limits of the basic types; the limit `array` checks arrays, which a class may convert."""


def _make_type_limit(hint: Any) -> Limit:
    """Return the limit to values of a type."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _make_type_limit(arguments[0])
    if origin is Literal:
        return _make_literal_limit(arguments)
    if origin in (Union, UnionType):
        return _make_union_limit([_make_type_limit(member) for member in arguments])
    if origin is tuple:
        return _make_tuple_limit(arguments)
    return _make_class_limit(origin or hint)


def _make_literal_limit(choices: tuple[Any, ...]) -> Limit:
    """Return the limit to some values of their own types: 'a', 'b' or 'c'."""
    *others, final = map(repr, choices)
    return Limit(
        lambda value: any(isinstance(value, type(x)) and value == x for x in choices),
        f"{', '.join(others)} or {final}" if others else final,
    )


def _make_class_limit(cls: Any) -> Limit:
    """Return the limit to instances of a class; every value passes if they cannot be recognised."""
    if cls in TYPE_LIMITS:
        return TYPE_LIMITS[cls]
    try:
        isinstance(None, cls)
    except TypeError:  # Any, a protocol, a type variable
        return ANY_VALUE
    article = "an" if cls.__name__[0] in "AEIOU" else "a"
    return Limit(lambda value: isinstance(value, cls), f"{article} {cls.__name__}")


def _make_union_limit(members: list[Limit]) -> Limit:
    """Return the limit to values of a union."""
    expected = dict.fromkeys(limit.expected for limit in members)
    return Limit(lambda value: any(limit.holds(value) for limit in members), " or ".join(expected))


def _make_tuple_limit(entries: tuple[Any, ...]) -> Limit:
    """Return the limit to tuples; a list or an array of the same entries passes too."""
    limits = [_make_type_limit(entry) for entry in entries if entry is not Ellipsis]
    if Ellipsis in entries:
        entry_limit = limits[0]
        return Limit(
            lambda values: _is_list(values) and all(map(entry_limit.holds, values)),
            f"a list, each {entry_limit.expected}",
        )
    count = len(limits)
    noun = "numbers" if {limit.expected for limit in limits} == {"a number"} else "values"

    def all_hold(values: Any) -> bool:
        if not _is_list(values) or len(values) != count:
            return False
        return all(limit.holds(value) for limit, value in zip(limits, values, strict=True))

    return Limit(all_hold, f"{COUNT_WORDS.get(count, count)} {noun}")


def _is_list(values: Any) -> bool:
    return isinstance(values, tuple | list) or (isinstance(values, np.ndarray) and values.ndim > 0)
