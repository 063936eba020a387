"""The explanations under the fields of settings, for the command line's help and the page."""

import ast
import inspect
import textwrap
from dataclasses import is_dataclass
from functools import cache
from typing import Any, cast


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
