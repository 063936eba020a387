"""Numbers as the controller keeps, reads and writes them.

It has one type: 32 bits before the point and 16 after it. Source: command reference, Mathematical
operations, and MG, PF, VF.
"""

import math
from collections.abc import Sequence

FRACTION = 65536
"""Parts of one that a number is counted in."""

GREATEST = 2147483647
"""The greatest whole number."""


class Refusal(Exception):
    """What a command asks for cannot be done; `code` is what TC tells."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def kept(value: float) -> float:
    """A number as the controller keeps it."""
    if not -GREATEST - 1 <= value < GREATEST + 1:
        raise Refusal(6)
    return math.floor(value * FRACTION) / FRACTION


def shown(value: float) -> str:
    """One number, as MG and a variable's question mark show it (VF 10.4)."""
    return f" {value:.4f}"


def listed(values: Sequence[float], digits: int = 0) -> str:
    """Several numbers, as TP and its like show them (PF 10.0)."""
    return " " + ", ".join(f"{value:.{digits}f}" for value in values)
