"""Schema of a tick: each column has as many numbers as parts, with the units of its source."""

import numpy as np
import pytest

from conftest import make_laboratory
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.numerics.structs import Field, RowField
from rcmservo.recording.tick_schema import (
    FLAG_COLUMNS,
    INTEGER_COLUMNS,
    NAME_COLUMNS,
    REAL_COLUMNS,
    Column,
)
from rcmservo.safety.monitor_state import MonitorState
from rcmservo.servo.state import Decision, Estimate

COLUMNS = (*INTEGER_COLUMNS, *REAL_COLUMNS, *FLAG_COLUMNS)
PAIRS = [
    (column, field)
    for row in (Estimate, Decision, MonitorState)
    for field in row.fields
    if not isinstance(field, RowField)
    for column in COLUMNS
    if column.name == field.name
]


def units(field: Field) -> list[str]:
    """Return the unit of each number of a field: one for all, or one for each row."""
    units_of_rows = (field.unit or "1").split(", ")
    return np.repeat(units_of_rows, np.prod(field.shape, dtype=int) // len(units_of_rows)).tolist()


def test_most_decisions_of_the_servo_are_compared_here() -> None:
    names = {column.name for column, _ in PAIRS}
    assert names >= {
        "o_c",
        "y",
        "delta",
        "predicted_delta",
        "J_hat",
        "v",
        "condition",
        "latency",
        "accepted_frame",
    }


@pytest.mark.parametrize(("column", "field"), PAIRS, ids=lambda one: one.name)
def test_a_column_has_the_units_of_its_source(column: Column, field: Field) -> None:
    assert [part.partition("[")[2].rstrip("]") for part in column.parts] == units(field)


def test_every_column_has_as_many_numbers_as_parts() -> None:
    lab = make_laboratory()
    (tick,) = servo_ticks(lab.plant, lab.servo(), lab.target, until=lambda tick: True)
    for column in (*COLUMNS, *NAME_COLUMNS):
        assert np.size(column.value_of(tick)) == len(column.parts), column.name
