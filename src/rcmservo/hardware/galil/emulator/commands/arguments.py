"""How the arguments of a command are written.

BG ABC   BGXY   ST A      some axes; none means all
JG 100,,-200   AC ?,?     a value for each axis in turn, or a question
JGA=100   SPB=x*2   KP*=5  a value for the axes that are named
"""

import re
from typing import NamedTuple

from rcmservo.hardware.galil.emulator.numbers import Refusal
from rcmservo.hardware.galil.emulator.state import LETTERS, OTHER_LETTERS

NAMED = re.compile(r"\s*([A-HW-Z]+|\*)\s*=\s*(.+)$")


class Assigned(NamedTuple):
    """What a command gives one axis."""

    axis: int
    """Its place."""
    text: str
    """An expression, or "?"."""


def axes_in(text: str, count: int) -> list[int]:
    """The places of the axes that a command names, all where it names none."""
    letters = text.replace(" ", "").replace(",", "").translate(OTHER_LETTERS)
    places = [LETTERS.find(letter) for letter in letters] or list(range(count))
    if not all(0 <= place < count for place in places):
        raise Refusal(4)
    return places


def assigned(text: str, count: int) -> list[Assigned]:
    """What a command gives each axis that it names."""
    match = NAMED.match(text)
    if match is not None:
        named = range(count) if match.group(1) == "*" else axes_in(match.group(1), count)
        return [Assigned(axis, match.group(2).strip()) for axis in named]
    parts = split(text)
    if len(parts) > count:
        raise Refusal(4)
    given = [Assigned(i, part) for i, part in enumerate(parts) if part]
    if not given:
        raise Refusal(50)
    return given


def split(text: str) -> list[str]:
    """What stands between commas, but for those within brackets, braces and quotes."""
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
