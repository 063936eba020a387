"""The command line as settings; what is wrong with it as one sentence."""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

import tyro
from tyro import _errors as tyro_errors
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from rcmservo.errors import RcmServoError, told


class Unparsed(RcmServoError):
    """A command line that does not say what to do."""


Commands = dict[str, type[Any]]
"""The options of every command, by its name."""

NUMBERS: dict[type[Any], tuple[str, str]] = {
    int: ("INT", "a whole number"),
    float: ("FLOAT", "a number"),
}
"""How the help calls a number, and how a sentence does."""


OURS = "must be"
"""How a message begins that is ours, not tyro's."""

OptionalPath = Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")]
"""The kind of an option that may be left out."""


def parse(commands: Commands, arguments: list[str], default: Any = tyro.MISSING) -> Any:
    """The options of the command that the arguments name. :class:`Unparsed` says what is wrong."""

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        name = arguments[0] if arguments and arguments[0] in commands else None
        sentence = _sentence(event, commands, arguments)
        raise Unparsed(f"{sentence}; see rcmservo {f'{name} ' if name else ''}--help")

    # tyro hands what is wrong to this hook only; its printed text is meant for eyes
    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(
            _any_of(commands),
            prog="rcmservo",
            description="Position a tool through a remote centre of motion from the picture of one "
            "uncalibrated camera. `rcmservo --version` tells the version.",
            args=arguments,
            default=default,
            registry=_numbers(),
        )


def _any_of(commands: Commands) -> Any:
    kinds = [Annotated[kind, tyro.conf.subcommand(name)] for name, kind in commands.items()]
    union: Any = kinds[0]
    for kind in kinds[1:]:
        union = union | kind
    return union


def _numbers() -> ConstructorRegistry:
    """How numbers are read: as tyro does, but what is none is told in our words."""
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:  # pyright: ignore[reportUnusedFunction]
        if info.type not in NUMBERS:
            return None
        kind = cast(Any, info.type)
        metavar, what = NUMBERS[kind]
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar=metavar,
            instance_from_str=lambda words: _read(kind, words[0], what),
            is_instance=lambda value: isinstance(value, kind),
            str_from_instance=lambda value: [str(value)],
        )

    return registry


def _read(kind: Callable[[str], Any], word: str, what: str) -> Any:
    try:
        return kind(word)
    except ValueError:
        raise ValueError(f"{OURS} {what}, got {told(word)}") from None


def _sentence(event: tyro_errors.ParseErrorEvent, commands: Commands, words: list[str]) -> str:
    """What is wrong with the words of a command line, without where to read more."""
    match event:
        case tyro_errors.MissingSubcommand():
            return f"a command must be given, one of {', '.join(commands)}"
        case tyro_errors.UnrecognizedArgs():
            return _unknown(event.tokens[0], commands, words[0])
        case tyro_errors.MissingArgs():
            missing = event.missing_arguments[0].arg
            helptext: Any = missing.field.helptext
            return f"{missing.lowered.metavar} must be given: {helptext()}".rstrip(".")
        case tyro_errors.InvalidChoice():
            right = f"one of {', '.join(event.choices)}"
            near = _near(event.value, event.choices)
            return f"{_name(event.argument)} must be {right}, got {told(event.value)}{near}"
        case tyro_errors.BadValue() | tyro_errors.InstantiationFailure():
            return _refused(event, words)
        case _:
            return "these arguments do not go together"


def _refused(event: Any, words: list[str]) -> str:
    """Values that are too few, of another kind, or of no use; the settings and our numbers say
    why."""
    message = " ".join(getattr(event, "message", "").split())
    if event.argument is None:
        return message
    name = _name(event.argument)
    if message.startswith(OURS):
        return f"{name} {message}"
    after = words[words.index(name) + 1 :] if name in words else []
    given = " ".join(takewhile(lambda word: not word.startswith("--"), after))
    return f"{name} must be given {event.argument.lowered.metavar}, got {told(given)}"


def _name(argument: Any) -> str:
    """What an option or argument is called on the command line."""
    names = argument.lowered.name_or_flags
    return str(argument.lowered.metavar if argument.is_positional() else names[0])


def _unknown(word: str, commands: Commands, first: str) -> str:
    """A sentence about a word that was not expected."""
    if first not in commands:
        known = ", ".join(commands)
        return f"the command must be one of {known}, got {told(word)}{_near(word, commands)}"
    if word.startswith("-"):
        return f"{first} has no option {word}{_near(word, _options(commands[first]))}"
    return f"{told(word)} is more than {first} takes"


def _near(word: str, known: Any) -> str:
    near = get_close_matches(word, list(known), 1)
    return f" (did you mean {near[0]}?)" if near else ""


def _options(kind: type[Any], prefix: str = "--") -> Iterator[str]:
    """The options that the fields of a dataclass make."""
    hints = get_type_hints(kind, include_extras=True)
    for one in fields(kind):
        inner = get_args(hints[one.name]) if get_origin(hints[one.name]) is Annotated else ()
        nameless = any(getattr(marker, "name", None) == "" for marker in inner[1:])
        hint: Any = inner[0] if inner else hints[one.name]
        if is_dataclass(hint):
            yield from _options(hint, prefix if nameless else f"{prefix}{one.name}.")  # pyright: ignore[reportArgumentType]
        else:
            yield (prefix + one.name).replace("_", "-")
