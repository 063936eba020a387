"""The command line as settings; what is wrong with it as one sentence."""

import re
import sys
from itertools import takewhile
from typing import Any

import tyro
from tyro import _errors as tyro_errors
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from rcmservo.cli.command_line.help_text import HELP_ALL_OPTION, HELP_OPTIONS
from rcmservo.cli.command_line.options import METAVARS, options_of, without_none
from rcmservo.cli.command_line.suggestions import suggest_options
from rcmservo.errors import BadInput, RcmServoError, quoted, suggestion


class InvalidCommandLine(RcmServoError):
    """A command line that does not say what to do."""


SETTING_OPTION = re.compile(r"--[\w-]+\.")
"""An option of a group, which only the long help explains."""

NUMBER_DESCRIPTIONS: dict[type[Any], str] = {int: "a whole number", float: "a number"}
"""Words for the kinds of numbers in messages."""


REQUIREMENT_START = "must be"
"""How a message begins that is ours, not tyro's."""


def parse(command: str, kind: type[Any], arguments: list[str], defaults: Any = None) -> Any:
    """Return the options that the arguments after the command's name give; `usual` holds those
    that are not given. :class:`Unparsed` names what cannot be read.
    """
    default: Any = {} if defaults is None else {"default": defaults}

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        sentence = _describe_error(event, command, kind, arguments)
        more = HELP_ALL_OPTION if SETTING_OPTION.search(sentence) else HELP_OPTIONS[1]
        raise InvalidCommandLine(f"{sentence}; see rcmservo {command} {more}")

    # tyro hands what is wrong to this hook only; its printed text is meant for eyes
    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(
            kind, prog="rcmservo", args=arguments, registry=_value_registry(), **default
        )


def _value_registry() -> ConstructorRegistry:
    """Return the reading of single values, which may be left out (`int | None`): as tyro reads
    them, but with our names and sentences, and no word stands for None.
    """
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def value(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:  # pyright: ignore[reportUnusedFunction]
        kind = without_none(info.type)
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
    event: tyro_errors.ParseErrorEvent, command: str, kind: type[Any], words: list[str]
) -> str:
    """What is wrong with the words of a command line, without where to read more."""
    match event:
        case tyro_errors.UnrecognizedArgs():
            word = event.tokens[0]
            if not word.startswith("-"):
                return f"{quoted(word)} is more than {command} takes"
            names = [one.name for one in options_of(kind) if not one.is_positional]
            return f"{command} has no option {word}{suggest_options(word, names)}"
        case tyro_errors.MissingArgs():
            missing = event.missing_arguments[0].arg
            helptext: Any = missing.field.helptext
            meaning = " ".join(helptext().split())
            return f"{missing.lowered.metavar} must be given: {meaning}".rstrip(".")
        case tyro_errors.InvalidChoice():
            right = f"one of {', '.join(event.choices)}"
            near = suggestion(event.value, event.choices)
            return (
                f"{_argument_name(event.argument)} must be {right}, got {quoted(event.value)}{near}"
            )
        case tyro_errors.BadValue() | tyro_errors.InstantiationFailure():
            return _describe_refusal(event, kind, words)
        case _:
            return "these arguments do not go together"


def _describe_refusal(event: Any, kind: type[Any], words: list[str]) -> str:
    """Values that are too few, of another kind, or of no use; the settings and our numbers say
    why.
    """
    message = " ".join(getattr(event, "message", "").split())
    if event.argument is None:
        return _describe_setting_error(sys.exception(), kind) or message
    name = _argument_name(event.argument)
    if message.startswith(REQUIREMENT_START):
        return f"{name} {message}"
    after = words[words.index(name) + 1 :] if name in words else []
    given = " ".join(takewhile(lambda word: not word.startswith("--"), after))
    metavar = str(event.argument.lowered.metavar)
    numbers = {METAVARS[number]: words for number, words in NUMBER_DESCRIPTIONS.items()}
    right = numbers.get(metavar, f"given {metavar}")
    return f"{name} must be {right}, got {quoted(given)}"


def _describe_setting_error(failure: BaseException | None, kind: type[Any]) -> str:
    """Return what a settings class refused, with the option's name as typed; empty if unknown.

    The class names the field as records and files do: `estimator.gamma` is --flow.gamma or
    --projection.gamma here. Tyro's error names the group, and has that of the class as context;
    what the options themselves refuse comes as it is.
    """
    cause = failure.__context__ if failure and not isinstance(failure, BadInput) else failure
    if not isinstance(cause, BadInput):
        return ""
    group = str(getattr(failure, "arg", "")).replace("_", "-")
    key = group, cause.field.rpartition(".")[2]
    name = next((one.name for one in options_of(kind) if (one.group, one.field) == key), "")
    return str(BadInput(name, cause.value, cause.right)) if name else ""


def _argument_name(argument: Any) -> str:
    """What an option or argument is called on the command line."""
    names = argument.lowered.name_or_flags
    return str(argument.lowered.metavar if argument.is_positional() else names[0])
