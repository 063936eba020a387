"""What the page shows is what the loop had: the same tick's numbers, and where it expected the
markers."""

from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from conftest import laboratory
from rcmservo.method.estimators.dlt import DltEstimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.page.board import Board
from rcmservo.page.desk import Desk


def seen(
    estimator: rs.Estimator, seconds: float
) -> tuple[list[rs.Tick], list[dict[str, Any]], Board]:
    """A run, what the page would show after each of its ticks, and the page's board."""
    lab, desk = laboratory(), Desk(get_context("spawn"))
    board, tables = Board(desk), list[dict[str, Any]]()
    ticks = list[rs.Tick]()
    for tick in rs.run(lab.plant, lab.servo(estimator=estimator), lab.target, seconds):
        desk.ticks.put(tick)
        board.look()
        ticks.append(tick)
        tables.append(board.table())
    return ticks, tables, board


@pytest.mark.parametrize("estimator", [DltEstimator(), ProjectionEstimator()])
def test_the_board_tells_the_tick_and_its_ghost_is_where_the_servo_expects_the_markers(
    estimator: rs.Estimator,
) -> None:
    ticks, tables, _ = seen(estimator, 3.0)
    expected = 0
    for tick, table in zip(ticks, tables, strict=True):
        state = tick.state
        for name, number in (("y", state.y), ("delta", state.delta), ("q", tick.seen.q)):
            shown = np.array(table[name], dtype=float)
            assert np.array_equal(shown, number, equal_nan=True), name
        known = tick.servo.learner.predict(state.learnt.memory, tick.servo.tool, state.p1)
        assert known is not None
        for ghost, m in zip(table["ghost"], np.reshape(known, (2, 2)), strict=True):
            there = m + state.o_c
            assert ghost == (there.tolist() if np.isfinite(there).all() else None)
            expected += ghost is not None
    assert expected > len(ticks)
    away = np.array(tables[-1]["ghost"]) - tables[-1]["points"]
    assert np.abs(away).max() < 5.0
