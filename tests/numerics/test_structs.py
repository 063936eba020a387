"""Structs with named fields, declared once and read alike by compiled functions and Python."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from rcmservo.interfaces import Floats
from rcmservo.numerics.structs import (
    Row,
    copy_row,
    flag,
    part,
    real,
    reals,
    replace_fields,
    to_row,
    whole,
)
from rcmservo.safety.gate import CommandStruct
from rcmservo.safety.monitor_state import MonitorState, initial_monitor_state
from rcmservo.safety.state_machine import ModeStruct
from rcmservo.safety.thresholds import Thresholds
from rcmservo.servo.state import Decision, Estimate, StoredState


class Pair(Row):
    """Row for these tests."""

    point: Floats = reals(2, "mm", "position")
    size: float = real("mm", "diameter")
    count: int = whole("", "number of samples")
    known: bool = flag("the position is known")


def test_a_row_has_named_numbers_and_writable_arrays() -> None:
    pair = Pair.of(point=[1.0, 2.0], size=3.0, count=4, known=True)
    pair.point[1] = 5.0
    assert pair.point.tolist() == [1.0, 5.0]
    assert (pair.size, pair.count, pair.known) == (3.0, 4, True)


class PairOfPairs(Row):
    """Row with two parts, for these tests."""

    one: Pair = part(Pair, "first part")
    other: Pair = part(Pair, "second part")


def test_a_part_is_a_view_of_its_row() -> None:
    both = PairOfPairs.of(one=Pair.of(size=3.0, point=1.0), other=Pair.of(count=4))
    both.one.point[1] = 5.0
    assert (both.one.point.tolist(), both.one.size, both.other.count) == ([1.0, 5.0], 3.0, 4)
    other = replace_fields(both, other=Pair.of(count=6))
    assert (other.one.size, other.other.count, both.other.count) == (3.0, 6, 4)


def test_a_copy_is_bitwise_equal_and_shares_no_memory() -> None:
    both = PairOfPairs.of(one=Pair.of(size=np.nan, known=True, point=-0.0))
    twin = copy_row(both)
    assert twin.rows.tobytes() == both.rows.tobytes() and twin.rows.dtype == both.rows.dtype
    twin.one.point[0] = 7.0
    assert both.one.point[0] == 0.0 and pickle.loads(pickle.dumps(twin)).one.point[0] == 7.0


def test_a_batch_is_an_array_of_the_same_rows() -> None:
    batch = np.zeros(7, Pair.dtype)
    batch["size"] = np.arange(7.0)
    assert Pair(batch[3:4]).size == 3.0


@pytest.mark.parametrize(
    "row", [MonitorState, Estimate, Decision, ModeStruct, CommandStruct, StoredState]
)
def test_every_field_of_the_servo_structs_has_a_shape_and_a_meaning(row: type[Row]) -> None:
    assert row.dtype.names == tuple(field.name for field in row.fields)
    assert all(field.meaning for field in row.fields)
    assert len(row.fields) > 3


@dataclass(frozen=True)
class Numbers:
    """Settings for these tests; an integer default of a float field becomes a float."""

    fraction: float = 1
    ends: tuple[float, float, float] = (1, 2, 3)
    times: int = 5
    on: bool = True


def test_settings_become_a_row_of_their_declared_types() -> None:
    rows = to_row(Numbers())
    kinds = {name: rows.dtype[name].base.str for name in rows.dtype.names}
    assert kinds == {"fraction": "<f8", "ends": "<f8", "times": "<i8", "on": "|b1"}
    assert rows["ends"][0].tolist() == [1.0, 2.0, 3.0]


def test_settings_of_a_kind_have_one_layout_object() -> None:
    # Numba compares the fields of another one at each call: 4 us for a tick of a second servo
    assert to_row(Thresholds()).dtype is to_row(Thresholds(max_jump_px=4)).dtype


@dataclass(frozen=True)
class Settings:
    """Settings with parts."""

    numbers: Numbers
    pair: Pair


def test_settings_with_parts_become_nested_rows() -> None:
    rows = to_row(Settings(Numbers(fraction=3), Pair.of(count=4)))
    assert rows["numbers"]["fraction"][0] == 3.0 and rows["pair"]["count"][0] == 4
    assert rows.dtype["pair"] == Pair.dtype and rows.dtype["numbers"] == to_row(Numbers()).dtype


def test_two_initial_monitor_states_share_no_memory() -> None:
    one, other = initial_monitor_state(), initial_monitor_state()
    one.predicted_joints[:] = 1.0
    assert np.isnan(other.predicted_joints).all()
