"""Limits of settings, declared as annotations of dataclass fields and checked at construction.

    @dataclass(frozen=True)
    class SaturatedController(Checked, section="controller"):
        gain: Annotated[float, positive("gain in 1/s")] = 8.0

refuses ``gain=-1`` and ``gain="fast"`` with ``BadInput``: "controller.gain must be a positive gain
in 1/s, got -1". The classes stay plain dataclasses, and pydantic reads them from files. They are
not pydantic's own dataclasses: importing pydantic and building a schema of each class would add
0.2 s to the 0.3 s of ``import rcmservo``.
"""

import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, fields
from functools import cache
from numbers import Real
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from rcmservo.errors import BadInput, suggestion

Triple = tuple[float, float, float]
"""Three numbers, such as one for each joint."""

COUNTS = {2: "two", 3: "three"}
"""Small numbers as messages spell them."""


@dataclass(frozen=True)
class Limit:
    """A condition that a value must meet, as metadata of ``Annotated``.

    Parameters
    ----------
    holds : Callable[[Any], bool]
        Test of a value of the right kind. NaN fails it.
    expected : str
        Words for the values that meet it.
    hint : Callable[[Any], str]
        Words that follow, made of the refused value.
    """

    holds: Callable[[Any], bool]
    expected: str
    hint: Callable[[Any], str] = field(default=lambda value: "")

    def require(self, name: str, value: Any) -> None:
        """Raise ``BadInput`` about the field or argument of a name unless its value meets it."""
        try:
            good = self.holds(value)
        except (TypeError, ValueError):  # of another kind, which cannot be compared
            good = False
        if not good:
            raise BadInput(name, value, self.expected + self.hint(value))


def _shown(number: float) -> str:
    """Return a number as short as it is exact: 0.1, 16000, 1e-9."""
    text = f"{number:g}"
    exact = text if float(text) == number else f"{number:.10g}"
    return re.sub(r"e\+?(-?)0*", r"e\1", exact)


def positive(what: str = "number") -> Limit:
    """Return the limit to finite numbers above 0; `what` is a noun with its unit."""
    return Limit(lambda x: 0.0 < x < math.inf, f"a positive {what}")


def not_negative(what: str = "number") -> Limit:
    """Return the limit to finite numbers from 0 on."""
    return Limit(lambda x: 0.0 <= x < math.inf, f"a {what} that is not negative")


def finite(what: str = "number") -> Limit:
    """Return the limit to finite numbers."""
    return Limit(math.isfinite, f"a finite {what}")


def between(low: float, high: float, what: str = "a number", unit: str = "") -> Limit:
    """Return the limit to numbers from `low` to `high`, both included."""
    words = f"{what} from {_shown(low)} to {_shown(high)} {unit}"
    return Limit(lambda x: low <= x <= high, words.strip())


def above(low: float, high: float = math.inf, what: str = "a number", unit: str = "") -> Limit:
    """Return the limit to finite numbers above `low` and at most `high`."""
    most = f" and at most {_shown(high)}" if high < math.inf else ""
    words = f"{what} above {_shown(low)}{most} {unit}"
    return Limit(lambda x: low < x <= high and x < math.inf, words.strip())


def inside(low: float, high: float, what: str = "a number") -> Limit:
    """Return the limit to numbers between `low` and `high`, both excluded."""
    return Limit(lambda x: low < x < high, f"{what} above {_shown(low)} and below {_shown(high)}")


def at_least(low: float, what: str) -> Limit:
    """Return the limit to finite numbers from `low` on."""
    return Limit(lambda x: low <= x < math.inf, f"at least {_shown(low)} {what}")


def at_most(high: float, what: str) -> Limit:
    """Return the limit to numbers whose size is at most `high`."""
    return Limit(lambda x: abs(x) <= high, f"at most {_shown(high)} {what}")


FRACTION = above(0.0, 1.0, "a share")
"""Limit to numbers above 0 and at most 1."""


def each(limit: Limit, words: str) -> Limit:
    """Return the limit of a tuple whose entries all meet a limit."""
    return Limit(lambda values: all(map(limit.holds, values)), words)


def array(*shape: int) -> Limit:
    """Return the limit to arrays, or lists of lists, of finite numbers in a shape."""

    def holds(values: object) -> bool:
        try:
            numbers = np.asarray(values, np.float64)
        except (TypeError, ValueError, OverflowError):
            return False
        return numbers.shape == shape and bool(np.isfinite(numbers).all())

    many = COUNTS.get(shape[0], shape) if len(shape) == 1 else shape
    return Limit(holds, f"{many} finite numbers")


def three_positive(units: str) -> Limit:
    """Return the limit to three finite numbers above 0, with their units."""
    return each(positive(), f"three positive numbers ({units})")


def angles(most: float, first: int, unit: str = "rad") -> Limit:
    """Return the limit of the `first` entries of a tuple to sizes of at most `most` rad (or rad/s).

    A larger angle was given in degrees: the message names both units.
    """

    def largest(values: Collection[float]) -> float:
        return max(map(abs, tuple(values)[:first]))

    def meant(values: Collection[float]) -> str:
        degrees, size = unit.replace("rad", "deg"), largest(values)
        return f" (did you mean {math.radians(size):.4g} {unit}, which is {size:g} {degrees}?)"

    expected = f"at most {most:.4g} {unit} where it is an angle"
    return Limit(lambda values: largest(values) <= most, expected, meant)


@dataclass(frozen=True)
class OneOf(Limit):
    """The limit to some words, such as the names of a registry, which may grow.

    Parameters
    ----------
    choices : Collection[str]
        The words.
    """

    choices: Collection[str] = field(default=(), hash=False)


def one_of(choices: Collection[str]) -> OneOf:
    """Return the limit to some words; the message lists them and suggests the nearest."""

    def listed(word: object) -> str:
        return ", ".join(choices) + suggestion(word, choices)

    return OneOf(lambda word: word in choices, "one of ", listed, choices)


def choices_of(hint: Any) -> tuple[str, ...]:
    """Return the words that a setting's type allows; empty for another type."""
    inner, *metadata = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    for limit in metadata:
        if isinstance(limit, OneOf):
            return tuple(limit.choices)
    return get_args(inner) if get_origin(inner) is Literal else ()


def matching(pattern: str, words: str) -> Limit:
    """Return the limit to texts that match a regular expression as a whole."""
    compiled = re.compile(pattern, re.ASCII)
    return Limit(lambda text: compiled.fullmatch(text) is not None, words)


def not_empty(words: str) -> Limit:
    """Return the limit to texts that are not blank, or to collections with an entry."""
    return Limit(lambda x: bool(x.strip() if isinstance(x, str) else x), words)


class Checked:
    """Base of frozen dataclasses whose fields must be of their kinds and within their limits.

    A subclass with rules between fields checks them in ``__post_init__``, after
    ``super().__post_init__()``.

    Raises
    ------
    BadInput
        At construction, with the field, its value and the expected value.
    """

    __slots__ = ()
    section: ClassVar[str] = ""
    """The name of the class in files and messages; subclasses inherit it."""

    def __init_subclass__(cls, section: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if section is not None:
            cls.section = section

    def __post_init__(self) -> None:
        """Raise ``BadInput`` for the first field that is not as its annotation says."""
        for name, kind, limits in _rules(type(self)):
            value = getattr(self, name)
            if not kind.holds(value):
                self.require(False, name, kind.expected + kind.hint(value))
            if value is not None:
                for limit in limits:
                    if not limit.holds(value):
                        self.require(False, name, limit.expected + limit.hint(value))

    def require(self, condition: object, name: str, expected: str) -> None:
        """Raise ``BadInput`` about a field unless a condition holds. NaN must fail it."""
        if not condition:
            path = f"{self.section}.{name}" if self.section else name
            raise BadInput(path, getattr(self, name), expected)


@cache
def _rules(cls: type[Any]) -> tuple[tuple[str, Limit, tuple[Limit, ...]], ...]:
    """Name, kind and limits of each field."""
    try:
        hints = get_type_hints(cls, include_extras=True)
    except NameError:  # a user's class whose annotations name what exists in a function only
        return ()
    return tuple((one.name, *_rule(hints[one.name])) for one in fields(cls))


def _rule(hint: Any) -> tuple[Limit, tuple[Limit, ...]]:
    """Kind and limits of a field; a value of another kind is refused in the words of a limit."""
    inner, *metadata = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    kind, limits = _kind(inner), tuple(one for one in metadata if isinstance(one, Limit))
    first = (limits or (kind,))[0]
    hint = first.hint if isinstance(first, OneOf) else kind.hint
    return Limit(kind.holds, first.expected, hint), limits


def _is_number(value: object) -> bool:
    """Report whether a value is a real number, no flag, that a float can hold."""
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


ANYTHING = Limit(lambda value: True, "any value")

KINDS: dict[Any, Limit] = {
    float: Limit(_is_number, "a number"),
    int: Limit(_is_whole, "a whole number"),
    bool: Limit(lambda value: isinstance(value, bool | np.bool), "true or false"),
    str: Limit(lambda value: isinstance(value, str), "text"),
    NoneType: Limit(lambda value: value is None, "left out"),
    np.ndarray: ANYTHING,
}
"""Values of each basic type; the limit `array` checks arrays, which a class may convert."""


def _kind(hint: Any) -> Limit:
    """Return the values of a type, as a limit."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _kind(inner[0])
    if origin is Literal:
        return Limit(lambda value: any(_same(value, one) for one in inner), _listed(inner))
    if origin in (Union, UnionType):
        return _any_kind([_kind(one) for one in inner])
    if origin is tuple:
        return _tuple_kind(inner)
    return _class_kind(origin or hint)


def _class_kind(plain: Any) -> Limit:
    """Return the kind of a class; anything passes where its instances cannot be recognised."""
    if plain in KINDS:
        return KINDS[plain]
    try:
        isinstance(None, plain)
    except TypeError:  # Any, a protocol, a type variable
        return ANYTHING
    noun = plain.__name__
    article = "an" if noun[0] in "AEIOU" else "a"
    return Limit(lambda value: isinstance(value, plain), f"{article} {noun}")


def _any_kind(kinds: list[Limit]) -> Limit:
    """Return the kind of a union."""
    words = dict.fromkeys(kind.expected for kind in kinds)
    return Limit(lambda value: any(kind.holds(value) for kind in kinds), " or ".join(words))


def _tuple_kind(inner: tuple[Any, ...]) -> Limit:
    """Return the kind of tuples; a list or an array of the same entries passes too."""
    kinds = [_kind(one) for one in inner if one is not Ellipsis]
    if Ellipsis in inner:
        each_fits = kinds[0].holds
        words = f"a list, each {kinds[0].expected}"
        return Limit(lambda values: _is_list(values) and all(map(each_fits, values)), words)
    tests = [kind.holds for kind in kinds]
    entries = "numbers" if {kind.expected for kind in kinds} == {"a number"} else "values"
    return Limit(
        lambda values: (
            _is_list(values)
            and len(values) == len(tests)
            and all(test(value) for test, value in zip(tests, values, strict=True))
        ),
        f"{COUNTS.get(len(kinds), len(kinds))} {entries}",
    )


def _is_list(values: Any) -> bool:
    return isinstance(values, tuple | list) or (isinstance(values, np.ndarray) and values.ndim > 0)


def _same(value: object, choice: object) -> bool:
    return isinstance(value, type(choice)) and value == choice


def _listed(choices: tuple[Any, ...]) -> str:
    """Return choices as a sentence lists them: 'a', 'b' or 'c'."""
    *others, last = map(repr, choices)
    return f"{', '.join(others)} or {last}" if others else last
