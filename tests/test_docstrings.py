"""Docstrings: summary lines by PEP 257, and complete numpydoc sections of public names."""

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import pytest
from numpydoc.validate import validate

import rcmservo as rs
from conftest import ROOT
from rcmservo.config.field_docs import PARAMETERS_SECTION, read_parameter_descriptions

QUESTION_WORD = re.compile(r"(What|How|Where|Whether|Why|Who|When)\b")
QUESTION_STRING = re.compile(rf"[\"']\s*(\\\n\s*)?{QUESTION_WORD.pattern}")
CHECKED_FOLDERS = "src", "tests", "benchmarks", "docs", "examples"
NOT_REQUIRED = {
    "ES01",  # an extended summary
    "SA01",  # a See Also section
    "EX01",  # an example
    "PR08",  # a capital letter, which symbols such as p₁ do not have
    "YD01",  # a Yields section of a generator whose summary says what it yields
}
"""Findings of numpydoc that are no fault here."""


def question_summaries() -> Iterator[str]:
    """Yield docstrings whose summary begins with a question word."""
    for folder in CHECKED_FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            text = path.read_text()
            # most files have no string that begins so, and need no slow parsing
            for node in ast.walk(ast.parse(text)) if QUESTION_STRING.search(text) else ():
                documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
                if documented and QUESTION_WORD.match(ast.get_docstring(node) or ""):
                    yield f"{path.relative_to(ROOT)}: {getattr(node, 'name', 'module')}"


def test_no_summary_line_begins_with_a_question_word() -> None:
    assert list(question_summaries()) == []


def stale_parameters() -> Iterator[str]:
    """Yield entries of Parameters sections that are no parameters of their function."""
    for path in sorted((ROOT / "src").rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "    Parameters\n" in text else ():
            if isinstance(node, ast.FunctionDef):
                section = PARAMETERS_SECTION.search(ast.get_docstring(node) or "")
                entries = re.findall(r"^\*{0,2}(\w+) :", section[1] if section else "", re.M)
                named = {one.arg for one in ast.walk(node.args) if isinstance(one, ast.arg)}
                yield from (
                    f"{path.name}: {node.name}.{name}" for name in entries if name not in named
                )


def test_every_documented_parameter_of_a_function_exists() -> None:
    assert list(stale_parameters()) == []


def public_objects() -> dict[str, Any]:
    """Classes and functions that `import rcmservo as rs` offers."""
    offered = {name: getattr(rs, name) for name in dir(rs)}
    return {
        name: one
        for name, one in offered.items()
        if inspect.isclass(one) or inspect.isfunction(one)
    }


def is_never_called(kind: type[Any]) -> bool:
    """A class that has members or implementations, but whose parameters nobody passes."""
    return issubclass(kind, Enum) or getattr(kind, "_is_protocol", False)


def all_fields_are_described(kind: type[Any]) -> bool:
    """Settings are described once, in the Parameters section of the class that declares them."""
    described = read_parameter_descriptions(kind)
    return is_dataclass(kind) and all(f.name in described for f in fields(kind))


@pytest.mark.parametrize("name", sorted(public_objects()))
def test_a_public_name_has_complete_numpydoc_sections(name: str) -> None:
    errors = dict(validate(f"rcmservo.{name}")["errors"])
    value = getattr(rs, name)
    if inspect.isclass(value) and (is_never_called(value) or all_fields_are_described(value)):
        errors.pop("PR01", None)
    assert {code: errors[code] for code in errors.keys() - NOT_REQUIRED} == {}


def test_dir_gives_the_public_names_and_nothing_else() -> None:
    assert dir(rs) == sorted([*rs.__all__, *rs.PUBLIC_PACKAGES, "__version__"])
