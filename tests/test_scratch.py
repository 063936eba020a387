"""Scratch arrays lie on the stack, each call with its own; arrays that nothing counts are the same
arrays."""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.memory import scratch, scratch_table, unowned


class Held(NamedTuple):
    """An array in a tuple in a tuple."""

    number: float
    inner: tuple[Floats, int]


@compiled
def filled(number: float) -> float:
    line, table = scratch(3), scratch_table(2, 4)
    for k in range(3):
        line[k] = number + k
    for k in range(8):
        table[k // 4, k % 4] = k
    if number > 0.0:
        number = filled(number - 1.0)
    return number + line[0] + line[2] + table.sum()


@compiled
def doubled(held: Held) -> float:
    same = unowned(held)
    for k in range(len(same.inner[0])):
        same.inner[0][k] *= 2.0
    return same.number


def test_scratch_is_room_of_its_own_for_each_call() -> None:
    plain = filled.py_func  # pyright: ignore[reportFunctionMemberAccess]
    assert filled(1.0) == plain(1.0) == 62.0


def test_an_array_that_nothing_counts_is_still_the_same_array_afterwards() -> None:
    numbers = np.arange(4.0)
    for _ in range(1000):
        assert doubled(Held(5.0, (numbers, 1))) == 5.0
        numbers *= 0.5
    assert np.array_equal(numbers, np.arange(4.0))
    assert unowned(numbers) is numbers
