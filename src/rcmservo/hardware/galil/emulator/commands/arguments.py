"""Parsing of command arguments.

BG ABC   BGXY   ST A       axes; none means all
JG 100,,-200   AC ?,?      one value or question mark per axis, in order
JGA=100   SPB=x*2   KP*=5  a value for the named axes
"""

import re
from functools import lru_cache
from typing import NamedTuple

from rcmservo.hardware.galil.data_record import AXIS_LETTERS
from rcmservo.hardware.galil.emulator.axis import Axis
from rcmservo.hardware.galil.emulator.state import (
    CACHED_TEXTS,
    OLD_TO_NEW_LETTERS,
    ControllerState,
)
from rcmservo.hardware.galil.error_codes import CommandError, ErrorCode

NAMED_AXES = re.compile(r"\s*([A-HW-Z]+|\*)\s*=\s*(.+)$")


class AxisAssignment(NamedTuple):
    """Value that a command assigns to one axis.

    Parameters
    ----------
    axis : int
        Index of the axis.
    text : str
        Expression, or "?" as a query.
    """

    axis: int
    text: str


def select_axes(state: ControllerState, arguments: str) -> list[Axis]:
    """Return the named axes, or all axes if none is named."""
    return [state.axes[index] for index in _parse_axes(arguments, len(state.axes))]


def parse_assignments(state: ControllerState, arguments: str) -> list[AxisAssignment]:
    """Return the values that a command assigns to axes."""
    count = len(state.axes)
    match = NAMED_AXES.match(arguments)
    if match is not None:
        axes = range(count) if match.group(1) == "*" else _parse_axes(match.group(1), count)
        return [AxisAssignment(axis, match.group(2).strip()) for axis in axes]
    parts = split_arguments(arguments)
    if len(parts) > count:
        raise CommandError(ErrorCode.OPERAND_ERROR)
    assignments = [AxisAssignment(axis, part) for axis, part in enumerate(parts) if part]
    if not assignments:
        raise CommandError(ErrorCode.NOT_ENOUGH_FIELDS)
    return assignments


@lru_cache(CACHED_TEXTS)
def split_arguments(text: str) -> tuple[str, ...]:
    """Split a text at its commas, except for those in brackets, braces and quotes."""
    parts, depth, in_quotes = [""], 0, False
    for character in text:
        in_quotes ^= character == '"'
        depth += not in_quotes and character in "([{"
        depth -= not in_quotes and character in ")]}"
        if character == "," and depth == 0 and not in_quotes:
            parts.append("")
        else:
            parts[-1] += character
    return tuple(part.strip() for part in parts)


def _parse_axes(letters: str, count: int) -> list[int]:
    """Return the indices of the axes with these letters, or of all `count` axes if empty."""
    letters = letters.replace(" ", "").replace(",", "").translate(OLD_TO_NEW_LETTERS)
    indices = [AXIS_LETTERS.find(letter) for letter in letters] or list(range(count))
    if not all(0 <= index < count for index in indices):
        raise CommandError(ErrorCode.OPERAND_ERROR)
    return indices
