"""List of a command's options, read from its dataclass for help, suggestions and messages.

No option is defined here. To add one, add a field to the dataclass of the command's options (see
cli.py); this module then lists it.
"""

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin, get_type_hints

import tyro

from rcmservo.config.field_docs import describe_field
from rcmservo.constraints import find_choices

METAVARS: dict[type[Any], str] = {int: "INT", float: "FLOAT", str: "TEXT", Path: "PATH"}
"""Placeholders (metavars) of values in the help, by type."""


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
        """Description of the option, read from the docstring of its dataclass."""
        return describe_field(self.owner, self.field)

    @property
    def is_positional(self) -> bool:
        """True if the argument is given without a name."""
        return not self.name.startswith("--")

    @property
    def is_flag(self) -> bool:
        """True if the option takes no value."""
        return not self.metavar


def list_options(options_class: type[Any], group: str = "") -> Iterator[Option]:
    """Yield the options of a dataclass, those of its groups last.

    Parameters
    ----------
    options_class : type
        Dataclass of a command's options, or of the settings in a group.
    group : str
        Prefix of the options; empty for those of the command itself.

    Yields
    ------
    Option
        One option or positional argument.
    """
    groups = find_option_groups(options_class)
    hints = get_type_hints(options_class, include_extras=True)
    for field in fields(options_class):
        option_name = _convert_to_option_name(field.name)
        if option_name in groups:
            continue
        hint = hints[field.name]
        annotations = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        metavars = (getattr(annotation, "metavar", None) for annotation in annotations)
        metavar = next(filter(None, metavars), None) or _choose_metavar(hint)
        typed_name = f"--{group}.{option_name}" if group else f"--{option_name}"
        name = metavar if tyro.conf.Positional in annotations else typed_name
        default = _format_default(field.default)
        yield Option(options_class, field.name, group, name, metavar, default)
    for name, settings_class in groups.items():
        yield from list_options(settings_class, name)


def find_option_groups(options_class: type[Any]) -> dict[str, type[Any]]:
    """Return the settings classes that a command's options contain, by the prefix of each group."""
    hints = get_type_hints(options_class).items()
    return {
        _convert_to_option_name(name): cast(type[Any], hint)
        for name, hint in hints
        if is_dataclass(hint)
    }


def _convert_to_option_name(field_name: str) -> str:
    return field_name.replace("_", "-")


def remove_none_type(hint: Any) -> Any:
    """Return the type of the values of an optional option: `int` for `int | None`."""
    if get_origin(hint) in (Union, UnionType):
        return next(member for member in get_args(hint) if member is not NoneType)
    return hint


def _choose_metavar(hint: Any) -> str:
    """Return the placeholder for values of a type."""
    choices = find_choices(hint)
    if choices:
        return choices[0] if len(choices) == 1 else f"{{{','.join(choices)}}}"
    value_type = remove_none_type(get_args(hint)[0] if get_origin(hint) is Annotated else hint)
    if get_origin(value_type) is tuple:
        entry_types = (entry for entry in get_args(value_type) if entry is not Ellipsis)
        return " ".join(map(_choose_metavar, entry_types))
    return "" if value_type is bool else METAVARS[value_type]


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
