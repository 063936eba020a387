"""The options of a command as a list, read from its dataclass: for the help, for suggestions, and
for messages that name an option."""

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import tyro

from rcmservo.config.field_docs import docstrings

METAVARS = {"int": "INT", "float": "FLOAT", "str": "TEXT", "Path": "PATH"}
"""How the help calls a value, by its type."""


@dataclass(frozen=True)
class Option:
    """One option or positional argument of a command."""

    path: tuple[str, ...]
    """Field names that lead to it from the command's dataclass."""
    name: str
    """As typed, such as --controller.gain; of a positional argument its metavar."""
    metavar: str
    """What its values are called; empty for a flag."""
    default: str
    """Its default as it would be typed; empty if there is none to show."""
    group: str
    """Part of its name that it shares with other options, such as controller; or empty."""
    owner: type[Any]
    """The dataclass whose field it is."""

    @property
    def words(self) -> str:
        """What it means, read from the source of its dataclass."""
        return docstrings(self.owner).get(self.path[-1], "")

    @property
    def is_positional(self) -> bool:
        """True if it is given without a name."""
        return not self.name.startswith("--")

    @property
    def is_flag(self) -> bool:
        """True if it is given without a value."""
        return not self.metavar


def options_of(kind: type[Any]) -> list[Option]:
    """Return the options of a command in their order."""
    return list(_walk(kind, (), ""))


def group_words(kind: type[Any]) -> dict[str, str]:
    """Return the explanations of the groups of options, by their names."""
    words: dict[str, str] = {}
    for name, hint, markers in _fields(kind):
        if is_dataclass(hint):
            inner = cast(type[Any], hint)
            words |= group_words(inner) if _is_nameless(markers) else {}
            words |= {} if _is_nameless(markers) else {_typed(name): docstrings(kind).get(name, "")}
    return words


def _walk(kind: type[Any], path: tuple[str, ...], group: str) -> Iterator[Option]:
    defaults = {one.name: _default(one) for one in fields(kind)}
    for name, hint, markers in _fields(kind):
        here = (*path, name)
        if is_dataclass(hint):
            inner = cast(type[Any], hint)
            yield from _walk(inner, here, group if _is_nameless(markers) else _typed(name))
            continue
        metavar = _named(markers, "metavar") or _metavar(hint)
        positional = tyro.conf.Positional in markers
        typed = f"{group}.{_typed(name)}" if group else _typed(name)
        yield Option(
            here,
            metavar if positional else f"--{typed}",
            metavar,
            _shown(defaults[name]),
            group,
            kind,
        )


def _fields(kind: type[Any]) -> Iterator[tuple[str, Any, tuple[Any, ...]]]:
    """Name, type and markers of each field."""
    hints = get_type_hints(kind, include_extras=True)
    for one in fields(kind):
        hint = hints[one.name]
        marked = get_origin(hint) is Annotated
        inner, *markers = get_args(hint) if marked else (hint,)
        yield one.name, inner, tuple(markers)


def _typed(name: str) -> str:
    return name.replace("_", "-")


def _named(markers: tuple[Any, ...], attribute: str) -> str:
    found = (getattr(marker, attribute, None) for marker in markers)
    return next((one for one in found if one), "")


def _is_nameless(markers: tuple[Any, ...]) -> bool:
    """True if a group's name is no part of its options' names."""
    return any(getattr(marker, "name", None) == "" for marker in markers)


def _metavar(hint: Any) -> str:
    """Return what the values of a type are called."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint is bool:
        return ""
    if origin is Literal:
        return inner[0] if len(inner) == 1 else f"{{{','.join(map(str, inner))}}}"
    if origin in (Union, UnionType):
        return next(_metavar(one) for one in inner if one is not NoneType)
    if origin is tuple:
        return " ".join(_metavar(one) for one in inner if one is not Ellipsis)
    return METAVARS.get(getattr(hint, "__name__", ""), "VALUE")


def _default(one: Any) -> Any:
    return one.default_factory() if one.default_factory is not MISSING else one.default


def _shown(value: Any) -> str:
    """Return a default as it would be typed."""
    match value:
        case None | () | "":
            return ""
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.4g}" if value else "0"
        case tuple():
            return " ".join(map(_shown, cast(tuple[Any, ...], value)))
        case _:
            return "" if value is MISSING else str(value)
