"""Strict decoding of tables from TOML and JSON into settings.

The settings dataclass is the only schema of a table: its fields are the keys, and their types are
the types of the values. Unknown keys, other types and numbers that are not finite raise `BadInput`
with the path of the key. An error that the dataclass itself raises receives this path too.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, cast, get_args, get_type_hints

from rcmservo.config.former_names import find_present_name
from rcmservo.errors import BadInput, quote_value, suggest_name

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

Settings = TypeVar("Settings")

EXPECTED_VALUES = {
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
"""Expected value by pydantic's type of error."""

MAX_LISTED_NAMES = 20
"""Largest number of names that an error message lists."""

BARE_KEY = re.compile(r"[A-Za-z0-9_-]{1,60}")
"""Key that needs no quotes in TOML."""


def decode_settings(
    schema: type[Settings], table: object, path: str, other_keys: Sequence[str] = ()
) -> Settings:
    """Return the settings in a table.

    Parameters
    ----------
    schema : type
        Dataclass of the settings, the schema of the table.
    table : object
        Table from a file.
    path : str
        Path of the table in the file, for error messages.
    other_keys : Sequence of str
        Keys that the file permits in addition to the fields, for error messages.

    Returns
    -------
    Settings
        Instance of the dataclass.

    Raises
    ------
    BadInput
        If the table does not match the dataclass.
    """
    from pydantic import PydanticUserError, ValidationError

    try:
        return _build_validator(schema).validate_json(json.dumps([table], default=str))[0]
    except PydanticUserError as error:  # pydantic cannot read the type of a field
        expected = "a dataclass of numbers, strings, and tuples of them"
        raise BadInput(path, schema.__name__, expected) from error
    except ValidationError as error:
        # a misspelt key also leaves the correct key missing; the misspelt one helps more
        first_error = min(error.errors(), key=lambda details: details["type"] == "missing")
        _raise_bad_input(first_error, schema, path, other_keys)


@cache
def _build_validator(schema: type[Any]) -> "TypeAdapter[tuple[Any]]":
    """Return a validator of a list of one table, because a bare dataclass accepts no `config`."""
    from pydantic import ConfigDict, TypeAdapter

    strict = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    return TypeAdapter[tuple[Any]](cast(Any, tuple)[schema], config=strict)


def _raise_bad_input(
    error: "ErrorDetails", schema: type[Any], path: str, other_keys: Sequence[str]
) -> NoReturn:
    """Raise `BadInput` for an error of pydantic, with the path of its key."""
    steps, error_type, value = error["loc"][1:], error["type"], error["input"]
    path += "".join(f"[{s}]" if isinstance(s, int) else f".{quote_key(s)}" for s in steps)
    context = error.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, BadInput):
        name = cause.field.removeprefix(path.rpartition(".")[2] + ".")
        raise BadInput(f"{path}.{name}", cause.value, cause.expected) from cause
    if error_type == "unexpected_keyword_argument":
        valid_keys = _list_valid_keys(schema, steps, other_keys)
        raise BadInput(path, value, expect_one_of(str(steps[-1]), valid_keys))
    expected = EXPECTED_VALUES.get(error_type, f"a value of its type ({error_type})")
    if error_type == "missing" and isinstance(value, dict):
        value = None  # pydantic gives the whole table
    raise BadInput(path, value, expected.format(**context))


def _list_valid_keys(
    schema: type[Any], steps: Sequence[int | str], other_keys: Sequence[str]
) -> list[str]:
    """Return the valid keys of the table that contains the unknown key ``steps[-1]``."""
    *parents, _ = steps
    for step in parents:
        schema = get_args(schema)[0] if isinstance(step, int) else get_type_hints(schema)[step]
    keys = [f.name for f in fields(schema)] if is_dataclass(schema) else []
    return keys if parents else [*other_keys, *keys]


def expect_one_of(key: str, names: Sequence[str]) -> str:
    """Return the expected names for an unknown key, with the most similar one as a suggestion."""
    present = find_present_name(key, names)
    hint = f" (its name is {present} now)" if present else suggest_name(key, names)
    listed = names[:MAX_LISTED_NAMES]
    unlisted = f" and {len(names) - len(listed)} more" if len(names) > len(listed) else ""
    return f"left out or one of {', '.join(listed)}{unlisted}{hint}"


def quote_key(name: str) -> str:
    """Return a key as a message quotes it: in quotes unless it is a bare key, and shortened."""
    return name if BARE_KEY.fullmatch(name) else quote_value(name[:60])
