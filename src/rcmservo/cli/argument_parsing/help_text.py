"""Help of a command: the basic options on one page, and with `--help-all` the settings as well."""

import shutil
import textwrap
from collections.abc import Iterator
from dataclasses import fields
from itertools import groupby
from typing import Any

from rcmservo.cli.argument_parsing import option_introspection
from rcmservo.cli.argument_parsing.option_introspection import Option
from rcmservo.config.class_registry import ESTIMATORS, PRESETS, find_class_name
from rcmservo.config.field_docs import describe_class, extract_first_sentence
from rcmservo.config.user_estimators import ESTIMATOR_OPTION

HELP_OPTIONS, HELP_ALL_OPTION = ("-h", "--help"), "--help-all"
"""Options that print the basic options, and the one that prints all options."""
EXPLANATION_COLUMN = 22
"""Column at which the explanation of an option begins."""
MIN_WIDTH, MAX_WIDTH = 60, 100
"""Smallest and largest width of the help in columns."""


def format_help(command: str, options_class: type[Any], with_settings: bool) -> str:
    """Return the help of a command.

    Parameters
    ----------
    command : str
        Name of the command.
    options_class : type
        Dataclass of its options.
    with_settings : bool
        True to explain the settings in option groups, such as --controller.gain, as well.

    Returns
    -------
    str
        Text, as wide as the terminal.
    """
    width = min(max(shutil.get_terminal_size((80, 24)).columns, MIN_WIDTH), MAX_WIDTH)
    return "\n".join(_iterate_help_lines(command, options_class, with_settings, width))


def _iterate_help_lines(
    command: str, options_class: type[Any], with_settings: bool, width: int
) -> Iterator[str]:
    options = list(option_introspection.list_options(options_class))
    options.sort(key=lambda option: not option.is_positional)
    classes = option_introspection.find_option_groups(options_class)
    groups = list(dict.fromkeys(option.group for option in options if option.group))
    positionals = [option.name for option in options if option.is_positional]
    yield " ".join(["usage: rcmservo", command, *positionals, "[options]"])
    for paragraph in describe_class(options_class).split("\n\n"):
        yield ""
        yield from textwrap.wrap(" ".join(paragraph.split()), width)
    for group, group_options in groupby(options, key=lambda option: option.group):
        if with_settings or not group:
            yield ""
            description = describe_class(classes[group]) if group else ""
            heading = f"{group} options: {description}" if group else "options:"
            yield from textwrap.wrap(" ".join(heading.split()), width)
            for option in group_options:
                yield from _wrap_option(_format_usage(option), _format_explanation(option), width)
            if not group and groups:
                words = "Show this help, or also the settings."
                yield from _wrap_option(f"--help, {HELP_ALL_OPTION}", words, width)
            elif not group:
                yield from _wrap_option("--help", "Show this help.", width)
    if any(option.name == ESTIMATOR_OPTION for option in options):
        yield ""
        yield from _list_estimators(width)
    if groups and not with_settings:
        words = f"Settings of {', '.join(groups)}: rcmservo {command} {HELP_ALL_OPTION}"
        yield ""
        yield from textwrap.wrap(words, width, break_on_hyphens=False)


def _wrap_option(usage: str, explanation: str, width: int) -> Iterator[str]:
    """Yield the lines of an option: its explanation to the right, or below if its usage is long."""
    explanation_width = width - EXPLANATION_COLUMN
    lines = textwrap.wrap(
        explanation, explanation_width, break_long_words=False, break_on_hyphens=False
    )
    if len(usage) + 3 > EXPLANATION_COLUMN:
        yield from textwrap.wrap(f"  {usage}", width, subsequent_indent="      ")
        usage = ""
    for i, line in enumerate(lines or [""]):
        yield f"{f'  {usage}' if i == 0 else '':<{EXPLANATION_COLUMN}}{line}".rstrip()


def _format_usage(option: Option) -> str:
    """Return an option as typed: --video is --[no-]video, and others have their metavar."""
    if option.is_positional:
        return option.name
    if option.is_flag:
        separator = "." if "." in option.name else "--"
        group, _, name = option.name.rpartition(separator)
        return f"{group}{separator}[no-]{name}"
    return f"{option.name} {option.metavar}"


def _format_explanation(option: Option) -> str:
    default = f" (default: {option.default})" if option.default else ""
    return f"{option.description}{default}"


def _list_estimators(width: int) -> Iterator[str]:
    """Yield one line for each estimator name."""
    yield "estimators:"
    for name, description in describe_estimators().items():
        summary = textwrap.shorten(description, width - EXPLANATION_COLUMN, placeholder=" ...")
        yield from _wrap_option(name, summary, width)
    yield from _wrap_option("MODULE:CLASS", "your own estimator, such as mylab.rls:RLS", width)


def describe_estimators() -> dict[str, str]:
    """Return a description of one sentence for each built-in estimator, by name."""
    descriptions = {name: extract_first_sentence(cls) for name, cls in ESTIMATORS.items()}
    for name, preset in PRESETS.items():
        settings: Any = type(preset)
        changes = [
            f"{f.name}={getattr(preset, f.name)}"
            for f in fields(settings)
            if getattr(preset, f.name) != f.default
        ]
        descriptions[name] = f"{find_class_name(preset, ESTIMATORS)} with {', '.join(changes)}"
    return descriptions
