"""Help of a command: the basic options on one page, and with `--help-all` the settings as well."""

import shutil
import textwrap
from collections.abc import Iterator
from dataclasses import fields
from itertools import groupby
from typing import Any

from rcmservo.cli.argument_parsing.option_introspection import (
    Option,
    find_option_groups,
    list_options,
)
from rcmservo.config.field_docs import describe_class, extract_first_sentence
from rcmservo.config.registry import ESTIMATORS, PRESETS, find_class_name
from rcmservo.config.user_estimators import ESTIMATOR_OPTION

HELP_OPTIONS, HELP_ALL_OPTION = ("-h", "--help"), "--help-all"
"""Options that print the basic options, and the one that prints all options."""
EXPLANATION_COLUMN = 22
"""Column at which the explanation of an option begins."""
MIN_WIDTH, MAX_WIDTH = 60, 100
"""Smallest and largest width of the help in columns."""


def format_help(command: str, kind: type[Any], with_settings: bool) -> str:
    """Return the help of a command."""
    width = min(max(shutil.get_terminal_size((80, 24)).columns, MIN_WIDTH), MAX_WIDTH)
    return "\n".join(_iterate_help_lines(command, kind, with_settings, width))


def _iterate_help_lines(
    command: str, kind: type[Any], with_settings: bool, width: int
) -> Iterator[str]:
    options = sorted(list_options(kind), key=lambda option: not option.is_positional)
    classes = find_option_groups(kind)
    groups = list(dict.fromkeys(option.group for option in options if option.group))
    positionals = [option for option in options if option.is_positional]
    usage = ["usage: rcmservo", command, *(option.name for option in positionals), "[options]"]
    yield " ".join(usage)
    for paragraph in describe_class(kind).split("\n\n"):
        yield ""
        yield from textwrap.wrap(" ".join(paragraph.split()), width)
    for group, ones in groupby(options, key=lambda option: option.group):
        if with_settings or not group:
            yield ""
            words = " ".join(describe_class(classes[group]).split()) if group else ""
            head = f"{group} options:" if group else "options:"
            yield from textwrap.wrap(f"{head} {words}", width)
            for option in ones:
                yield from _wrap_option(_format_usage(option), _option_explanation(option), width)
            if not group:
                both = (f"--help, {HELP_ALL_OPTION}", "Show this help, or also the settings.")
                yield from _wrap_option(*(both if groups else ("--help", "Show this help.")), width)
    if any(option.name == ESTIMATOR_OPTION for option in options):
        yield ""
        yield from _list_estimators(width)
    if groups and not with_settings:
        words = f"Settings of {', '.join(groups)}: rcmservo {command} {HELP_ALL_OPTION}"
        yield ""
        yield from textwrap.wrap(words, width, break_on_hyphens=False)


def _wrap_option(left: str, right: str, width: int) -> Iterator[str]:
    """Yield the lines of an option: its explanation to the right, or below if its usage is long."""
    explanation = textwrap.wrap(
        right, width - EXPLANATION_COLUMN, break_long_words=False, break_on_hyphens=False
    )
    if len(left) + 3 > EXPLANATION_COLUMN:
        yield from textwrap.wrap(f"  {left}", width, subsequent_indent="      ")
        left = ""
    for k, line in enumerate(explanation or [""]):
        yield f"{f'  {left}' if k == 0 else '':<{EXPLANATION_COLUMN}}{line}".rstrip()


def _format_usage(option: Option) -> str:
    if option.is_positional:
        return option.name
    if option.is_flag:
        start, _, end = option.name.rpartition("." if "." in option.name else "--")
        return f"{start}{'.' if '.' in option.name else '--'}[no-]{end}"
    return f"{option.name} {option.metavar}"


def _option_explanation(option: Option) -> str:
    return (
        f"{option.description} (default: {option.default})"
        if option.default
        else option.description
    )


def _list_estimators(width: int) -> Iterator[str]:
    """Yield one line for each estimator name."""
    yield "estimators:"
    for name, words in describe_estimators().items():
        short = textwrap.shorten(words, width - EXPLANATION_COLUMN, placeholder=" ...")
        yield from _wrap_option(name, short, width)
    yield from _wrap_option("MODULE:CLASS", "your own estimator, such as mylab.rls:RLS", width)


def describe_estimators() -> dict[str, str]:
    """Return a description of one sentence for each built-in estimator, by name."""
    words = {name: extract_first_sentence(kind) for name, kind in ESTIMATORS.items()}
    for name, preset in PRESETS.items():
        kind: Any = type(preset)
        values = {f.name: (getattr(preset, f.name), f.default) for f in fields(kind)}
        changed = (
            f"{name}={value}" for name, (value, default) in values.items() if value != default
        )
        words[name] = f"{find_class_name(preset, ESTIMATORS)} with {', '.join(changed)}"
    return words
