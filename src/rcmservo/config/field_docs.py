"""Descriptions of settings, read from the docstrings of their classes.

Options, help texts and the page take them from the Parameters sections.
"""

import inspect
import re
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

from rcmservo.constraints import OneOf

PARAMETERS_SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=\n\n\S|\Z)", re.DOTALL | re.MULTILINE)
"""Parameters section of a numpydoc docstring."""

SECTION_HEADING = re.compile(r"\n\n[A-Z]\w+(?: \w+)?\n-+\n")
"""Heading of a section of a numpydoc docstring."""

PARAMETER_ENTRY = re.compile(r"^(\w+) :[^\n]*\n((?: +[^\n]+(?:\n|\Z))+)", re.MULTILINE)
"""Entry of a parameter: its name and the indented lines of its description."""


def describe_field(kind: type[Any], name: str) -> str:
    """Return the description of a field of a dataclass, with a sentence for each of its choices."""
    hint = get_type_hints(kind, include_extras=True)[name]
    limits = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    choices = [one.choices for one in limits if isinstance(one, OneOf)]
    described = [
        f"{choice}: {extract_first_sentence(cast(type[Any], type(value)))}."
        for registry in choices
        if isinstance(registry, Mapping)
        for choice, value in cast(Mapping[str, Any], registry).items()
    ]
    return " ".join((read_parameter_descriptions(kind).get(name, ""), *described))


def extract_first_sentence(kind: type[Any]) -> str:
    """Return the first sentence of a class's docstring, without its full stop."""
    return " ".join(describe_class(kind).split("\n\n")[0].split()).partition(". ")[0].rstrip(".")


def describe_class(kind: type[Any]) -> str:
    """Return the paragraphs of a class's docstring before its sections."""
    return SECTION_HEADING.split(inspect.getdoc(kind) or "")[0]


@cache
def read_parameter_descriptions(kind: type[Any]) -> dict[str, str]:
    """Return the descriptions of a dataclass's fields by name, each as one line.

    They come from the Parameters sections of the class and of its parents.
    """
    found: dict[str, str] = {}
    for parent in reversed(kind.__mro__):
        if is_dataclass(parent):
            found |= _described_parameters(inspect.cleandoc(parent.__doc__ or ""))
    return found


def _described_parameters(docstring: str) -> dict[str, str]:
    """Return the descriptions in the Parameters section of a docstring by parameter."""
    section = PARAMETERS_SECTION.search(docstring)
    entries = PARAMETER_ENTRY.findall(section[1]) if section else []
    return {name: " ".join(words.split()) for name, words in entries}
