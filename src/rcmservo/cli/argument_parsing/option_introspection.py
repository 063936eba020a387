"""Options of a command as a list, read from its dataclass for help, suggestions and messages."""

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin, get_type_hints

import tyro

from rcmservo.config.field_docs import describe_field
from rcmservo.constraints import choices_of

METAVARS: dict[type[Any], str] = {int: "INT", float: "FLOAT", str: "TEXT", Path: "PATH"}
"""Placeholder of a value in the help, by type."""


@dataclass(frozen=True)
class Option:
    """Option or positional argument of a command.

    Parameters
    ----------
    owner : type[Any]
        Dataclass that has the field.
    field : str
        Name of the field.
    group : str
        Prefix that the option shares with others, such as controller; empty if none.
    name : str
        Name as typed, such as --controller.gain; the metavar of a positional argument.
    metavar : str
        Placeholder of its values; empty for a flag.
    default : str
        Default as typed; empty if there is none to show.
    """

    owner: type[Any]
    field: str
    group: str
    name: str
    metavar: str
    default: str

    @property
    def description(self) -> str:
        """Description of the option, read from the source of its dataclass."""
        return describe_field(self.owner, self.field)

    @property
    def is_positional(self) -> bool:
        """True if the argument is given without a name."""
        return not self.name.startswith("--")

    @property
    def is_flag(self) -> bool:
        """True if the option takes no value."""
        return not self.metavar


def find_option_groups(kind: type[Any]) -> dict[str, type[Any]]:
    """Return the classes whose settings are option groups of a command, by group."""
    hints = get_type_hints(kind).items()
    return {
        _convert_to_option_name(name): cast(type[Any], hint)
        for name, hint in hints
        if is_dataclass(hint)
    }


def list_options(kind: type[Any], group: str = "") -> Iterator[Option]:
    """Yield the options of a command, groups last, or the options of field group's class."""
    groups = find_option_groups(kind)
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        if _convert_to_option_name(field.name) in groups:
            continue
        hint = hints[field.name]
        markers = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        metavars = (getattr(marker, "metavar", None) for marker in markers)
        metavar = next(filter(None, metavars), None) or _choose_metavar(hint)
        typed = (
            f"--{group}.{_convert_to_option_name(field.name)}"
            if group
            else f"--{_convert_to_option_name(field.name)}"
        )
        name = metavar if tyro.conf.Positional in markers else typed
        yield Option(kind, field.name, group, name, metavar, _format_default(field.default))
    for name, inner in groups.items():
        yield from list_options(inner, name)


def _convert_to_option_name(name: str) -> str:
    return name.replace("_", "-")


def remove_none_type(hint: Any) -> Any:
    """Return the type of the values of an optional option."""
    if get_origin(hint) in (Union, UnionType):
        return next(one for one in get_args(hint) if one is not NoneType)
    return hint


def _choose_metavar(hint: Any) -> str:
    """Return the placeholder for values of a type."""
    choices = choices_of(hint)
    if choices:
        return choices[0] if len(choices) == 1 else f"{{{','.join(choices)}}}"
    plain = remove_none_type(get_args(hint)[0] if get_origin(hint) is Annotated else hint)
    if get_origin(plain) is tuple:
        return " ".join(_choose_metavar(one) for one in get_args(plain) if one is not Ellipsis)
    return "" if plain is bool else METAVARS[plain]


def _format_default(value: Any) -> str:
    """Return a default as typed."""
    match value:
        case None | () | "":
            return ""
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.4g}" if value else "0"
        case tuple():
            return " ".join(map(_format_default, cast(tuple[Any, ...], value)))
        case _:
            return "" if value is MISSING else str(value)
