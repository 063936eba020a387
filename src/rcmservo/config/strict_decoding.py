"""A table as TOML and JSON give it becomes settings, strictly, or one sentence of what is wrong.

The settings dataclass is the only description of a table: its fields are the keys, their types what
the values must be. Unknown keys, wrong types and numbers that are not finite are refused by the
path of the key, and what a dataclass itself refuses is told with that path too.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, cast, get_args, get_type_hints

from rcmservo.config.former_names import present_name
from rcmservo.errors import BadInput, quoted, suggestion

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

Settings = TypeVar("Settings")

RIGHT = {
    "missing": "given",
    "float_type": "a finite number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "too_long": "a list of {max_length}",
    "literal_error": "{expected}",
    "dataclass_type": "a table of settings",
    "dict_type": "a table",
    "json_invalid": "plain text and numbers",
}
"""What would be right, by the kind of error."""

BARE = re.compile(r"[A-Za-z0-9_-]{1,60}")
"""A key that TOML needs no quotes for."""


def decode(kind: type[Settings], table: object, where: str, others: Sequence[str] = ()) -> Settings:
    """The settings in a table, which stands at ``where`` in its file; BadInput where they are not
    as the dataclass `kind` has them. The table in the file may hold the keys `others` too.
    """
    from pydantic import PydanticUserError, ValidationError

    try:
        return _reader(kind).validate_json(json.dumps([table], default=str))[0]
    except PydanticUserError as error:  # of a user's own class
        right = "a dataclass of numbers, words, and tuples of them"
        raise BadInput(where, kind.__name__, right) from error
    except ValidationError as error:
        first = min(error.errors(), key=lambda one: one["type"] == "missing")  # a misspelt key
        _refuse(first, kind, where, others)


@cache
def _reader(kind: type[Any]) -> "TypeAdapter[tuple[Any]]":
    """What reads a list of one table: of a lone dataclass pydantic takes no configuration."""
    from pydantic import ConfigDict, TypeAdapter

    strict = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    return TypeAdapter[tuple[Any]](cast(Any, tuple)[kind], config=strict)


def _refuse(error: "ErrorDetails", kind: type[Any], where: str, others: Sequence[str]) -> NoReturn:
    """Say the first thing that is wrong in our words."""
    way, what, value = error["loc"][1:], error["type"], error["input"]
    path = where + "".join(f"[{x}]" if isinstance(x, int) else f".{key_of(x)}" for x in way)
    given = error.get("ctx", {})
    cause = given.get("error")
    if isinstance(cause, BadInput):
        name = cause.field.removeprefix(path.rpartition(".")[2] + ".")
        raise BadInput(f"{path}.{name}", cause.value, cause.right) from cause
    if what == "unexpected_keyword_argument":
        raise BadInput(path, value, instead(str(way[-1]), _keys(kind, way, others)))
    right = RIGHT[what].format(**given) if what in RIGHT else f"a value of its kind ({what})"
    raise BadInput(path, None if what == "missing" and isinstance(value, dict) else value, right)


def _keys(kind: type[Any], way: Sequence[int | str], others: Sequence[str]) -> list[str]:
    """The keys that the table may have in which the last step of the way is none."""
    for step in way[:-1]:
        kind = get_args(kind)[0] if isinstance(step, int) else get_type_hints(kind)[step]
    names = [f.name for f in fields(kind)] if is_dataclass(kind) else []
    return names if way[:-1] else [*others, *names]


def instead(key: str, names: Sequence[str]) -> str:
    """The right thing to do with an unknown key: one of the known names, the nearest suggested."""
    present = present_name(key, names)
    hint = f" (its name is {present} now)" if present else suggestion(key, names)
    return f"left out or one of {', '.join(names)}{hint}"


def key_of(name: str) -> str:
    """A key as a sentence tells it: quoted if it is no plain word, and not all of a long one."""
    return name if BARE.fullmatch(name) else quoted(name[:60])
