"""The help of a command: the basics on one page, and with `--help-all` the settings too."""

import shutil
import textwrap
from collections.abc import Iterator
from dataclasses import fields
from itertools import groupby
from typing import Any

from rcmservo.cli.command_line.options import Option, groups_of, options_of
from rcmservo.config.field_docs import describe_class, first_sentence
from rcmservo.config.registry import ESTIMATORS, PRESETS, name_of
from rcmservo.config.user_code import OPTION as ESTIMATOR_OPTION

HELP_OPTIONS, HELP_ALL_OPTION = ("-h", "--help"), "--help-all"
"""Options that ask for the basics, and for everything."""
EXPLANATION_COLUMN = 22
"""Columns before the explanation of an option."""
MIN_WIDTH, MAX_WIDTH = 60, 100
"""Columns that a line of help has at least and at most."""


def help_text(command: str, kind: type[Any], everything: bool) -> str:
    """Return the help of a command as text."""
    width = min(max(shutil.get_terminal_size((80, 24)).columns, MIN_WIDTH), MAX_WIDTH)
    return "\n".join(_lines(command, kind, everything, width))


def _lines(command: str, kind: type[Any], everything: bool, width: int) -> Iterator[str]:
    options = sorted(options_of(kind), key=lambda one: not one.is_positional)
    classes = groups_of(kind)
    groups = list(dict.fromkeys(one.group for one in options if one.group))
    given = [one for one in options if one.is_positional]
    usage = ["usage: rcmservo", command, *(one.name for one in given), "[options]"]
    yield " ".join(usage)
    for paragraph in describe_class(kind).split("\n\n"):
        yield ""
        yield from textwrap.wrap(" ".join(paragraph.split()), width)
    for group, ones in groupby(options, key=lambda one: one.group):
        if everything or not group:
            yield ""
            words = " ".join(describe_class(classes[group]).split()) if group else ""
            head = f"{group} options:" if group else "options:"
            yield from textwrap.wrap(f"{head} {words}", width)
            for one in ones:
                yield from _option_lines(_option_usage(one), _option_explanation(one), width)
            if not group:
                both = (f"--help, {HELP_ALL_OPTION}", "Show this, or the settings too.")
                yield from _option_lines(*(both if groups else ("--help", "Show this.")), width)
    if any(one.name == ESTIMATOR_OPTION for one in options):
        yield ""
        yield from _estimator_lines(width)
    if groups and not everything:
        words = f"Settings of {', '.join(groups)}: rcmservo {command} {HELP_ALL_OPTION}"
        yield ""
        yield from textwrap.wrap(words, width, break_on_hyphens=False)


def _option_lines(left: str, right: str, width: int) -> Iterator[str]:
    """Return an option beside its explanation, or above it if it is long."""
    room = textwrap.wrap(
        right, width - EXPLANATION_COLUMN, break_long_words=False, break_on_hyphens=False
    )
    if len(left) + 3 > EXPLANATION_COLUMN:
        yield from textwrap.wrap(f"  {left}", width, subsequent_indent="      ")
        left = ""
    for k, line in enumerate(room or [""]):
        yield f"{f'  {left}' if k == 0 else '':<{EXPLANATION_COLUMN}}{line}".rstrip()


def _option_usage(one: Option) -> str:
    if one.is_positional:
        return one.name
    if one.is_flag:
        start, _, end = one.name.rpartition("." if "." in one.name else "--")
        return f"{start}{'.' if '.' in one.name else '--'}[no-]{end}"
    return f"{one.name} {one.metavar}"


def _option_explanation(one: Option) -> str:
    return f"{one.description} (default: {one.default})" if one.default else one.description


def _estimator_lines(width: int) -> Iterator[str]:
    """Return a line for each estimator that a name stands for."""
    yield "estimators:"
    for name, words in estimator_descriptions().items():
        short = textwrap.shorten(words, width - EXPLANATION_COLUMN, placeholder=" ...")
        yield from _option_lines(name, short, width)
    yield from _option_lines("MODULE:CLASS", "your own, such as mylab.rls:RLS", width)


def estimator_descriptions() -> dict[str, str]:
    """Return one sentence on each built-in estimator, by its name."""
    words = {name: first_sentence(kind) for name, kind in ESTIMATORS.items()}
    for name, preset in PRESETS.items():
        kind: Any = type(preset)
        given = {f.name: (getattr(preset, f.name), f.default) for f in fields(kind)}
        other = (f"{name}={value}" for name, (value, usual) in given.items() if value != usual)
        words[name] = f"{name_of(preset, ESTIMATORS)} with {', '.join(other)}"
    return words
