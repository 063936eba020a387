"""Parse a command line into the dataclass of a command's options; errors are one sentence each.

tyro, a library that derives a command line from a dataclass, does the parsing. This module replaces
its error messages.
"""

import re
import sys
from itertools import takewhile
from typing import Any

import tyro
from tyro import _errors as tyro_errors
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from rcmservo.cli.argument_parsing.help_text import HELP_ALL_OPTION, HELP_OPTIONS
from rcmservo.cli.argument_parsing.option_introspection import (
    METAVARS,
    list_options,
    remove_none_type,
)
from rcmservo.cli.argument_parsing.suggestions import suggest_options
from rcmservo.errors import BadInput, RcmServoError, quote_value, suggest_name


class InvalidCommandLine(RcmServoError):
    """Arguments that cannot be parsed."""


GROUP_OPTION = re.compile(r"--[\w-]+\.")
"""Option of a group, such as --controller.gain, which only --help-all explains."""

NUMBER_DESCRIPTIONS: dict[type[Any], str] = {int: "a whole number", float: "a number"}
"""Descriptions of the types of numbers in messages."""

REQUIREMENT_START = "must be"
"""Start of a message that this module wrote, and not tyro."""


def parse_options(
    command: str, options_class: type[Any], arguments: list[str], defaults: Any = None
) -> Any:
    """Return the options that the arguments after the command's name give.

    Parameters
    ----------
    command : str
        Name of the command, for messages.
    options_class : type
        Dataclass of its options.
    arguments : list of str
        Arguments after the command's name.
    defaults : Any
        Options that hold the values which the arguments leave out; by default those of the
        class.

    Returns
    -------
    object
        Instance of the dataclass.

    Raises
    ------
    InvalidCommandLine
        If an argument is unknown, missing or invalid.
    """
    default: Any = {} if defaults is None else {"default": defaults}

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        message = _describe_error(event, command, options_class, arguments)
        help_option = HELP_ALL_OPTION if GROUP_OPTION.search(message) else HELP_OPTIONS[1]
        raise InvalidCommandLine(f"{message}; see rcmservo {command} {help_option}")

    registry = _make_value_registry()
    # only this hook receives tyro's errors as objects; otherwise tyro prints them
    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(
            options_class, prog="rcmservo", args=arguments, registry=registry, **default
        )


def _make_value_registry() -> ConstructorRegistry:
    """Return the conversion of single values, which may be optional (`int | None`).

    It differs from tyro's in its names and messages, and no word stands for None.
    """
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def convert_value(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:  # pyright: ignore[reportUnusedFunction]
        value_type = remove_none_type(info.type)
        if value_type not in METAVARS:
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar=METAVARS[value_type],
            instance_from_str=lambda words: _convert(value_type, words[0]),
            is_instance=lambda value: value is None or isinstance(value, value_type),
            str_from_instance=lambda value: [str(value)],
        )

    return registry


def _convert(value_type: type[Any], word: str) -> Any:
    try:
        return value_type(word)
    except ValueError:
        expected = f"{NUMBER_DESCRIPTIONS[value_type]}, got {quote_value(word)}"
        raise ValueError(f"{REQUIREMENT_START} {expected}") from None


def _describe_error(
    event: tyro_errors.ParseErrorEvent, command: str, options_class: type[Any], arguments: list[str]
) -> str:
    """Return the message for an error, without the hint to the help."""
    match event:
        case tyro_errors.UnrecognizedArgs():
            word = event.tokens[0]
            if not word.startswith("-"):
                return f"{quote_value(word)} is one argument too many for {command}"
            names = [o.name for o in list_options(options_class) if not o.is_positional]
            return f"{command} has no option {word}{suggest_options(word, names)}"
        case tyro_errors.MissingArgs():
            missing = event.missing_arguments[0].arg
            helptext: Any = missing.field.helptext
            description = " ".join(helptext().split())
            return f"{missing.lowered.metavar} must be given: {description}".rstrip(".")
        case tyro_errors.InvalidChoice():
            expected = f"one of {', '.join(event.choices)}"
            hint = suggest_name(event.value, event.choices)
            name = _find_argument_name(event.argument)
            return f"{name} must be {expected}, got {quote_value(event.value)}{hint}"
        case tyro_errors.BadValue() | tyro_errors.InstantiationFailure():
            return _describe_refusal(event, options_class, arguments)
        case _:
            return "these arguments cannot be combined"


def _describe_refusal(event: Any, options_class: type[Any], arguments: list[str]) -> str:
    """Return the message for values that are too few, of another type, or refused by a setting."""
    message = " ".join(getattr(event, "message", "").split())
    if event.argument is None:
        return _describe_setting_error(sys.exception(), options_class) or message
    name = _find_argument_name(event.argument)
    if message.startswith(REQUIREMENT_START):
        return f"{name} {message}"
    following = arguments[arguments.index(name) + 1 :] if name in arguments else []
    values = " ".join(takewhile(lambda word: not word.startswith("--"), following))
    metavar = str(event.argument.lowered.metavar)
    number_descriptions = {METAVARS[number]: text for number, text in NUMBER_DESCRIPTIONS.items()}
    expected = number_descriptions.get(metavar, f"given {metavar}")
    return f"{name} must be {expected}, got {quote_value(values)}"


def _describe_setting_error(error: BaseException | None, options_class: type[Any]) -> str:
    """Return the message of a settings class with the option's name as typed; empty if unknown.

    The class names the field as records and files do: `estimator.gamma` is --flow.gamma or
    --projection.gamma on the command line. Tyro's error names the group and has that of the class
    as context. An error that the options themselves raise has no such context.
    """
    cause = error.__context__ if error and not isinstance(error, BadInput) else error
    if not isinstance(cause, BadInput):
        return ""
    group = str(getattr(error, "arg", "")).replace("_", "-")
    key = group, cause.field.rpartition(".")[2]
    names = (o.name for o in list_options(options_class) if (o.group, o.field) == key)
    name = next(names, "")
    return str(BadInput(name, cause.value, cause.expected)) if name else ""


def _find_argument_name(argument: Any) -> str:
    """Return the name of an option or argument on the command line."""
    names = argument.lowered.name_or_flags
    return str(argument.lowered.metavar if argument.is_positional() else names[0])
