"""Dashboard of the page: the numbers of the tick and the predicted markers."""

import json
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest
from dashboards import make_dashboard

import rcmservo as rs
from conftest import make_laboratory
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.page.channels import PageChannels
from rcmservo.page.messages import PoseTaught, Standby
from rcmservo.page.plots.curves import SAMPLE_FIELDS
from rcmservo.page.plots.mechanism_shape import MechanismShape
from rcmservo.page.pose_sequence import SequenceProgress
from rcmservo.page.view_model import Dashboard, encode_json, list_allowed_actions
from rcmservo.sim import RigSettings
from rcmservo.sim.processes.motion_log import MotionLog, TruePositionError
from rcmservo.sim.tool_body import ToolBody


def observe_run(
    estimator: rs.Estimator, seconds: float
) -> tuple[list[rs.Tick], list[dict[str, Any]], Dashboard]:
    """Run the loop; return its ticks, the dashboard after each of them, and the dashboard."""
    lab, channels = make_laboratory(), PageChannels(get_context("spawn"))
    board, tables = make_dashboard(channels), list[dict[str, Any]]()
    ticks = list[rs.Tick]()
    for tick in rs.servo_ticks(lab.plant, lab.servo(estimator=estimator), lab.target, seconds):
        channels.ticks.add(tick)
        board.update()
        ticks.append(tick)
        tables.append(board.to_table())
    return ticks, tables, board


@pytest.mark.parametrize("estimator", [DltEstimator(), ProjectionEstimator()])
def test_the_dashboard_holds_the_tick_and_the_predicted_markers(
    estimator: rs.Estimator,
) -> None:
    ticks, tables, _ = observe_run(estimator, 3.0)
    count = 0
    for tick, table in zip(ticks, tables, strict=True):
        state = tick.state
        for name, number in (("y", state.y), ("delta", state.delta), ("q", tick.observation.q)):
            displayed = np.array(table[name], dtype=float)
            assert np.array_equal(displayed, number, equal_nan=True), name
        known = tick.servo.guarded_estimator.predict(
            state.estimation.memory, tick.servo.tool, state.p1
        )
        assert known is not None
        for predicted, m in zip(table["predicted"], np.reshape(known, (2, 2)), strict=True):
            assert np.array_equal(predicted, m + state.o_c, equal_nan=True)
            count += np.isfinite(predicted).all()
    assert count > len(ticks)
    residual = np.array(tables[-1]["predicted"]) - tables[-1]["points"]
    assert np.abs(residual).max() < 5.0


def test_the_allowed_actions_depend_on_the_phase() -> None:
    moving, jog = {"teach_again", "teach", "go", "pause"}, {"jog"}
    expected = {phase: moving for phase in rs.Phase} | {
        rs.Phase.IDLE: moving | jog,
        rs.Phase.JOG: moving | jog,
        rs.Phase.PAUSED: moving - {"pause"} | {"resume"} | jog,
        rs.Phase.FAULT: {"clear"},
    }
    assert {phase: set(list_allowed_actions(phase)) for phase in rs.Phase} == expected


@pytest.mark.parametrize(
    ("standby", "phase", "can"),
    [
        (Standby("preparing"), "OFF", []),
        (Standby("the drive is error", can_enable=True), "OFF", ["enable"]),
        (Standby("STOP was pressed", is_latched=True), "FAULT", []),
        (Standby("STOP was pressed", is_latched=True, can_clear=True), "FAULT", ["clear"]),
    ],
)
def test_without_a_loop_the_drive_can_be_enabled_or_a_stop_cleared(
    standby: Standby, phase: str, can: list[str]
) -> None:
    table = make_dashboard(PageChannels(get_context("spawn")), standby=standby).to_table()
    assert (table["phase"], table["can"], table["recovery"]) == (
        phase,
        can,
        can[: standby.can_clear],
    )


def test_numbers_that_are_not_finite_are_null_in_a_browsers_json() -> None:
    table = {
        "y": np.array([1.0, np.nan]),
        "late": np.inf,
        "sequence": SequenceProgress("a", 1, 2, 3, 4, None),
    }
    content = json.loads(encode_json(table), parse_constant=pytest.fail)
    sequence = {
        "pose": "a",
        "waypoint_number": 1,
        "waypoints": 2,
        "round_number": 3,
        "rounds": 4,
        "remaining_s": None,
    }
    assert content == {"y": [1.0, None], "late": None, "sequence": sequence}


class LateClock:
    """Clock on which some waits end late, by ns given for the index of the wait."""

    def __init__(self, clock: rs.Clock, late: dict[int, int]) -> None:
        self._clock, self._late, self._count = clock, late, -1

    def now(self) -> int:
        return self._clock.now()

    def wait_until(self, time: int) -> None:
        self._count += 1
        self._clock.wait_until(time + self._late.get(self._count, 0))


def test_the_curves_hold_the_values_of_the_ticks_and_the_largest_lateness() -> None:
    lab, channels = make_laboratory(), PageChannels(get_context("spawn"))
    board, ticks = make_dashboard(channels), list[rs.Tick]()
    lab.plant.clock = LateClock(lab.plant.clock, {104: 4_000_000, 107: 7_000_000})
    for tick in rs.servo_ticks(lab.plant, lab.servo(), lab.target, 5.0):
        channels.ticks.add(tick)
        if len(ticks) % 7 == 0:
            board.update()
        ticks.append(tick)
    board.update()
    samples = np.array(board.curves.after(0))
    curves = dict(zip(SAMPLE_FIELDS, samples.T, strict=True))
    assert len(samples) == board.curves.count >= 28
    by_time = {tick.observation.now: tick for tick in ticks}
    for sample in samples:
        state = by_time[round(sample[0] * 1e9)].state
        assert np.array_equal(sample[1:4], state.delta, equal_nan=True)
        assert sample[4] == np.linalg.norm(state.v) and sample[5] == state.condition
    late = curves["late"]
    assert sorted(late)[-1] == pytest.approx(7.0, abs=1e-6) and (late > 0.1).sum() <= 2
    servoed = np.array([by_time[round(t * 1e9)].state.phase is rs.Phase.SERVO for t in curves["t"]])
    first = replace(
        ticks[0],
        observation=replace(ticks[0].observation, now=ticks[-1].observation.now + 1_555_000_000),
    )
    channels.ticks.add(first)
    board.update()
    assert board.curves.after(len(samples))[0][-1] == 0.0  # another loop has another schedule
    moves = servoed & (np.abs(curves["measured_r"]) > 20.0)
    assert moves.sum() > 5
    ratio = curves["predicted_r"][moves] / curves["measured_r"][moves]
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.1)
    assert len(board.curves.after(board.curves.count - 3)) == 3
    assert not board.curves.after(10**9)


def test_the_true_pose_error_belongs_to_the_joints_of_the_target() -> None:
    lab, settings = make_laboratory(), RigSettings()
    log = MotionLog(get_context("spawn"))
    log.add(0, 0, 0, False, np.zeros(3), lab.rig.scene.start)
    channels = PageChannels(get_context("spawn"))
    board = make_dashboard(channels, target=lab.target, truth=TruePositionError(settings, 0, log))
    body = ToolBody(settings.mechanism, settings.tool)
    error = body.points(lab.rig.scene.start)[1] - body.points(lab.target.q)[1]
    assert board.to_table()["truth_mm"] == pytest.approx(np.linalg.norm(error), abs=1e-3)
    log.add(0, 0, 0, False, np.zeros(3), lab.target.q)
    assert board.to_table()["truth_mm"] == 0.0
    assert make_dashboard(channels, target=lab.target).to_table()["truth_mm"] is None
    unknown = replace(lab.target, q=np.full(3, np.nan))
    assert (
        make_dashboard(channels, target=unknown, truth=board.truth).to_table()["truth_mm"] is None
    )


def test_markers_that_move_while_they_are_taught_are_reported() -> None:
    channels = PageChannels(get_context("spawn"))
    board, still = make_dashboard(channels), rs.Target(np.ones((2, 2)), np.zeros(3))
    for target in (still, replace(still, swing_px=1.5)):
        channels.status.send(PoseTaught("above", target))
    board.update()
    assert sum("both markers moved by ±1.5 px" in note for note in board.notes) == 1


def test_the_tool_in_the_scene_goes_through_its_markers() -> None:
    lab = make_laboratory()
    shape = MechanismShape.from_servo(lab.servo())
    q = lab.rig.scene.start
    tool, markers = shape.compute_points(q), lab.rig.body.points(q)[:2]
    assert np.allclose(tool[:2], markers, atol=0.5)
    assert np.allclose(np.cross(tool[0], tool[2]), 0.0, atol=1e-6)
    board = make_dashboard(PageChannels(get_context("spawn")), target=lab.target, shape=shape)
    assert np.allclose(
        board.to_table()["tool_target"], shape.compute_points(lab.target.q), atol=0.01
    )
    assert board.to_table()["tool"] is None
    limits, (_, upper) = shape.compute_workspace_surface(), lab.rig.settings.mechanism.limits.arrays
    assert np.allclose(limits[-1, -1], shape.compute_points(upper)[0])
