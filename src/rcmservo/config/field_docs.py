"""The explanations under the fields of settings, for the command line's help and the page."""

import ast
import inspect
import textwrap
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

from rcmservo.constraints import OneOf


def words_of(kind: type[Any], name: str) -> str:
    """Return the docstring of a field of a dataclass, with a sentence on each of its choices."""
    hint = get_type_hints(kind, include_extras=True)[name]
    limits = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    choices = [one.choices for one in limits if isinstance(one, OneOf)]
    described = [
        f"{choice}: {first_sentence(cast(type[Any], type(value)))}."
        for registry in choices
        if isinstance(registry, Mapping)
        for choice, value in cast(Mapping[str, Any], registry).items()
    ]
    return " ".join((docstrings(kind).get(name, ""), *described))


def first_sentence(kind: type[Any]) -> str:
    """Return the first sentence of a class's docstring, without its full stop."""
    words = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())
    return words.partition(". ")[0].rstrip(".")


@cache
def docstrings(kind: type[Any]) -> dict[str, str]:
    """The docstring below each field of a dataclass, on one line; of those that it inherits too."""
    found: dict[str, str] = {}
    for parent in reversed(kind.__mro__):
        if is_dataclass(parent):
            found |= _own_docstrings(cast(type[Any], parent))
    return found


def _own_docstrings(kind: type[Any]) -> dict[str, str]:
    """Those that stand in the class itself."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    found: dict[str, str] = {}
    for field, below in zip(body.body, body.body[1:], strict=False):
        match field, below:
            case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(words))):
                found[name] = " ".join(words.split())
            case _:
                """No field with a docstring."""
    return found
