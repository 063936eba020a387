"""Parsing of command arguments.

BG ABC   BGXY   ST A       axes; none means all
JG 100,,-200   AC ?,?      one value or question mark per axis, in order
JGA=100   SPB=x*2   KP*=5  a value for the named axes
"""

import re
from typing import NamedTuple

from rcmservo.hardware.galil.data_record import AXIS_LETTERS
from rcmservo.hardware.galil.emulator.expressions import CommandError
from rcmservo.hardware.galil.emulator.state import OLD_TO_NEW_LETTERS

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


def parse_axes(text: str, count: int) -> list[int]:
    """Return the indices of the named axes, or of all `count` axes if none is named."""
    letters = text.replace(" ", "").replace(",", "").translate(OLD_TO_NEW_LETTERS)
    indices = [AXIS_LETTERS.find(letter) for letter in letters] or list(range(count))
    if not all(0 <= index < count for index in indices):
        raise CommandError(4)
    return indices


def parse_assignments(text: str, count: int) -> list[AxisAssignment]:
    """Return the assignments of a command for a controller with `count` axes."""
    match = NAMED_AXES.match(text)
    if match is not None:
        axes = range(count) if match.group(1) == "*" else parse_axes(match.group(1), count)
        return [AxisAssignment(axis, match.group(2).strip()) for axis in axes]
    parts = split_arguments(text)
    if len(parts) > count:
        raise CommandError(4)
    assignments = [AxisAssignment(i, part) for i, part in enumerate(parts) if part]
    if not assignments:
        raise CommandError(50)
    return assignments


def split_arguments(text: str) -> list[str]:
    """Split a text at its commas, except for those in brackets, braces and quotes."""
    parts, depth, quoted = [""], 0, False
    for character in text:
        quoted ^= character == '"'
        depth += not quoted and character in "([{"
        depth -= not quoted and character in ")]}"
        if character == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]
