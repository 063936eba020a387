"""Parsing of TOML and JSON texts into tables.

In JSON, repeated keys and numbers that are not finite are refused; in TOML, repeated keys are.
Every refusal is a `ValueError` with a message of one line, or a `RecursionError` for a text that is
nested too deeply.
"""

import json
import math
import tomllib
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

from rcmservo.errors import BadInput, UnusableFile, quote_value, shorten_to_line
from rcmservo.interfaces import Floats

MAX_LINE_LENGTH = 1000
"""Maximum length of a line of TOML: the parser needs minutes for a key of ten thousand parts."""


Table = dict[str, Any]
"""Table of TOML or object of JSON."""

MarkerRadii = tuple[float | None, float | None]
"""Apparent radii of both markers, px; None where unknown."""

UNKNOWN_RADII: MarkerRadii = (None, None)


class InvalidText(ValueError):
    """Invalid content of a file; the message is a clause that follows the path of the file."""


@contextmanager
def name_file_in_errors(path: Path, language: str) -> Generator[None]:
    """Convert an error that is raised in the context into one that names the file.

    Parameters
    ----------
    path : Path
        File that is read in the context.
    language : str
        Language of the file, TOML or JSON, for the message.

    Raises
    ------
    BadInput
        If a field has an invalid value.
    UnusableFile
        If the text is not valid in its language, or was refused.
    """
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{path}: {error.field}", error.value, error.expected) from error
    except InvalidText as error:
        raise UnusableFile(path, str(error)) from error
    except RecursionError as error:
        raise UnusableFile(path, "is nested too deeply") from error
    except ValueError as error:  # of the parser, the decoder, or a number of thousands of digits
        raise UnusableFile(path, f"is not valid {language}: {shorten_to_line(error)}") from error


def parse_toml(data: bytes) -> Table:
    """Return the tables of a TOML file."""
    text = data.decode()
    if max(map(len, text.split("\n"))) > MAX_LINE_LENGTH:
        raise InvalidText(f"has a line of more than {MAX_LINE_LENGTH} characters")
    return tomllib.loads(text)


def parse_json(text: str) -> Any:
    """Return the value of a JSON text; raise `InvalidText` for repeated keys, NaN and infinity."""
    return json.loads(
        text,
        object_pairs_hook=_make_table,
        parse_constant=_parse_finite_number,
        parse_float=_parse_finite_number,
    )


def _make_table(pairs: list[tuple[str, Any]]) -> Table:
    """Return the table of keys and values; raise `InvalidText` for a repeated key."""
    for key, count in Counter(key for key, _ in pairs).items():
        if count > 1:
            raise InvalidText(f"has two of the key {quote_value(key)}")
    return dict(pairs)


def _parse_finite_number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise InvalidText(f"holds the number {text[:30]}, which is not finite")
    return value


def convert_unknown_to_null(values: Floats) -> list[float | None]:
    """Return numbers (n,) as JSON values: None in place of NaN, which means unknown."""
    return [float(value) if math.isfinite(value) else None for value in values]


def is_table(value: object) -> TypeGuard[Table]:
    """Return True if a parsed value is a table."""
    return isinstance(value, dict)
