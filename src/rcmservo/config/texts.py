"""The texts of TOML and JSON files as tables: repeated keys and numbers that are none are refused.

All refusals are ValueErrors in one line, and RecursionErrors for what is nested too deeply.
"""

import json
import math
import tomllib
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

from rcmservo.errors import BadInput, UnusableFile, one_line, quoted
from rcmservo.interfaces import Floats

MAX_LINE = 1000
"""Characters of a line of TOML: a key of ten thousand parts keeps the parser busy for minutes."""


Table = dict[str, Any]
"""What TOML calls a table and JSON an object."""


Sizes = tuple[float | None, float | None]
"""Apparent radii of both markers, px; None where not known."""

NO_SIZES: Sizes = (None, None)


class Refused(ValueError):
    """What is wrong with a text that was read."""


@contextmanager
def reading(path: Path, language: str) -> Generator[None]:
    """Name the file, and what is wrong with it, where a text that is read in here is refused."""
    try:
        yield
    except BadInput as error:
        raise BadInput(f"{path}: {error.field}", error.value, error.right) from error
    except Refused as error:
        raise UnusableFile(path, str(error)) from error
    except RecursionError as error:
        raise UnusableFile(path, "is nested too deeply") from error
    except ValueError as error:  # of the parser, of the encoding, of numbers of thousands of digits
        raise UnusableFile(path, f"is not valid {language}: {one_line(error)}") from error


def toml(data: bytes) -> Table:
    """The tables of a TOML file. (TOML itself refuses repeated keys.)"""
    text = data.decode()
    if max(map(len, text.split("\n"))) > MAX_LINE:
        raise Refused(f"has a line of more than {MAX_LINE} characters")
    return tomllib.loads(text)


def from_json(text: str) -> Any:
    """What a JSON text holds."""
    return json.loads(text, object_pairs_hook=_once, parse_constant=_number, parse_float=_number)


def _once(pairs: list[tuple[str, Any]]) -> Table:
    table = dict(pairs)
    if len(table) < len(pairs):
        key = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        raise Refused(f"has two of the key {quoted(key)}")
    return table


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise Refused(f"holds the number {text[:30]}, which is not finite")
    return value


def sizes(radii: Floats) -> list[float | None]:
    """Apparent radii (2,) px, of which NaN is not known, as JSON tells them."""
    return [float(radius) if math.isfinite(radius) else None for radius in radii]


def is_table(value: object) -> TypeGuard[Table]:
    """Whether a value that was read is a table."""
    return isinstance(value, dict)
