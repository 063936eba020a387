"""Options from a command line, and error messages of one sentence."""

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
from rcmservo.errors import BadInput, RcmServoError, quoted, suggestion


class InvalidCommandLine(RcmServoError):
    """Report arguments that cannot be read."""


SETTING_OPTION = re.compile(r"--[\w-]+\.")
"""Option of a group, which only the long help explains."""

NUMBER_DESCRIPTIONS: dict[type[Any], str] = {int: "a whole number", float: "a number"}
"""Types of numbers in words, for messages."""


REQUIREMENT_START = "must be"
"""Start of a message that was written here and not by tyro."""


def parse_options(command: str, kind: type[Any], arguments: list[str], defaults: Any = None) -> Any:
    """Return the options that the arguments after the command's name give.

    Parameters
    ----------
    command : str
        Name of the command, for messages.
    kind : type
        Dataclass of its options.
    arguments : list of str
        Arguments after the command's name.
    defaults : Any
        Options that hold the values which the arguments leave out; by default those of the
        class.

    Raises
    ------
    InvalidCommandLine
        If an argument is unknown, missing or invalid.
    """
    default: Any = {} if defaults is None else {"default": defaults}

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        sentence = _describe_error(event, command, kind, arguments)
        more = HELP_ALL_OPTION if SETTING_OPTION.search(sentence) else HELP_OPTIONS[1]
        raise InvalidCommandLine(f"{sentence}; see rcmservo {command} {more}")

    # only this hook receives tyro's errors as objects; otherwise tyro prints them
    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(
            kind, prog="rcmservo", args=arguments, registry=_make_value_registry(), **default
        )


def _make_value_registry() -> ConstructorRegistry:
    """Return the conversion of single values, which may be optional (`int | None`).

    It differs from tyro's in its names and messages, and no word stands for None.
    """
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def value(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:  # pyright: ignore[reportUnusedFunction]
        kind = remove_none_type(info.type)
        if kind not in METAVARS:
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar=METAVARS[kind],
            instance_from_str=lambda words: _convert(kind, words[0]),
            is_instance=lambda value: value is None or isinstance(value, kind),
            str_from_instance=lambda value: [str(value)],
        )

    return registry


def _convert(kind: type[Any], word: str) -> Any:
    try:
        return kind(word)
    except ValueError:
        raise ValueError(
            f"{REQUIREMENT_START} {NUMBER_DESCRIPTIONS[kind]}, got {quoted(word)}"
        ) from None


def _describe_error(
    event: tyro_errors.ParseErrorEvent, command: str, kind: type[Any], arguments: list[str]
) -> str:
    """Return the message for an error, without the hint to the help."""
    match event:
        case tyro_errors.UnrecognizedArgs():
            word = event.tokens[0]
            if not word.startswith("-"):
                return f"{quoted(word)} is one argument too many for {command}"
            names = [option.name for option in list_options(kind) if not option.is_positional]
            return f"{command} has no option {word}{suggest_options(word, names)}"
        case tyro_errors.MissingArgs():
            missing = event.missing_arguments[0].arg
            helptext: Any = missing.field.helptext
            meaning = " ".join(helptext().split())
            return f"{missing.lowered.metavar} must be given: {meaning}".rstrip(".")
        case tyro_errors.InvalidChoice():
            expected = f"one of {', '.join(event.choices)}"
            near = suggestion(event.value, event.choices)
            name = _find_argument_name(event.argument)
            return f"{name} must be {expected}, got {quoted(event.value)}{near}"
        case tyro_errors.BadValue() | tyro_errors.InstantiationFailure():
            return _describe_refusal(event, kind, arguments)
        case _:
            return "these arguments cannot be combined"


def _describe_refusal(event: Any, kind: type[Any], arguments: list[str]) -> str:
    """Return the message for values that are too few, of another type, or refused by a setting."""
    message = " ".join(getattr(event, "message", "").split())
    if event.argument is None:
        return _describe_setting_error(sys.exception(), kind) or message
    name = _find_argument_name(event.argument)
    if message.startswith(REQUIREMENT_START):
        return f"{name} {message}"
    following = arguments[arguments.index(name) + 1 :] if name in arguments else []
    given = " ".join(takewhile(lambda word: not word.startswith("--"), following))
    metavar = str(event.argument.lowered.metavar)
    numbers = {METAVARS[number]: arguments for number, arguments in NUMBER_DESCRIPTIONS.items()}
    expected = numbers.get(metavar, f"given {metavar}")
    return f"{name} must be {expected}, got {quoted(given)}"


def _describe_setting_error(failure: BaseException | None, kind: type[Any]) -> str:
    """Return the message of a settings class with the option's name as typed; empty if unknown.

    The class names the field as records and files do: `estimator.gamma` is --flow.gamma or
    --projection.gamma on the command line. Tyro's error names the group and has that of the class
    as context. An error that the options themselves raise has no such context.
    """
    cause = failure.__context__ if failure and not isinstance(failure, BadInput) else failure
    if not isinstance(cause, BadInput):
        return ""
    group = str(getattr(failure, "arg", "")).replace("_", "-")
    key = group, cause.field.rpartition(".")[2]
    name = next((one.name for one in list_options(kind) if (one.group, one.field) == key), "")
    return str(BadInput(name, cause.value, cause.expected)) if name else ""


def _find_argument_name(argument: Any) -> str:
    """Return the name of an option or argument on the command line."""
    names = argument.lowered.name_or_flags
    return str(argument.lowered.metavar if argument.is_positional() else names[0])
