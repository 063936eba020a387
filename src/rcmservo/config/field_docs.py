"""Descriptions of settings, read from the docstrings of their classes.

Command line, help and page take them from the numpydoc section Parameters of each settings class,
so that a setting is described in one place only.
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


def describe_field(settings_class: type[Any], name: str) -> str:
    """Return the description of a field of a dataclass, with a sentence for each of its choices."""
    hint = get_type_hints(settings_class, include_extras=True)[name]
    limits = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    choices = [limit.choices for limit in limits if isinstance(limit, OneOf)]
    sentences = [
        f"{choice}: {extract_first_sentence(cast(type[Any], type(value)))}."
        for values_by_name in choices
        if isinstance(values_by_name, Mapping)
        for choice, value in cast(Mapping[str, Any], values_by_name).items()
    ]
    return " ".join((read_parameter_descriptions(settings_class).get(name, ""), *sentences))


def extract_first_sentence(documented_class: type[Any]) -> str:
    """Return the first sentence of a class's docstring, without its full stop."""
    first_paragraph = describe_class(documented_class).split("\n\n")[0]
    return " ".join(first_paragraph.split()).partition(". ")[0].rstrip(".")


def describe_class(documented_class: type[Any]) -> str:
    """Return the paragraphs of a class's docstring before its sections."""
    return SECTION_HEADING.split(inspect.getdoc(documented_class) or "")[0]


@cache
def read_parameter_descriptions(settings_class: type[Any]) -> dict[str, str]:
    """Return the descriptions of a dataclass's fields by name, each as one line.

    They come from the Parameters sections of the class and of its parents.
    """
    descriptions: dict[str, str] = {}
    for parent in reversed(settings_class.__mro__):
        section = PARAMETERS_SECTION.search(inspect.cleandoc(parent.__doc__ or ""))
        if section and is_dataclass(parent):
            entries = PARAMETER_ENTRY.findall(section[1])
            descriptions |= {name: " ".join(text.split()) for name, text in entries}
    return descriptions
