"""Before the motion, the pixels of a target are compared with the joints of teaching.

A target whose pixels are not where the camera shows its joints stops the tool after exploration.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import (
    ESTIMATORS,
    SHAFT,
    Laboratory,
    make_laboratory,
    make_random,
    mark_others_slow,
    seeds,
)
from rcmservo.control.tool_speed_cap import UNCHECKED_TARGET_SPEED
from rcmservo.geometry.kinematics import compute_position
from rcmservo.geometry.tool import compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.loop.operator import OperatorRequest, Teach
from rcmservo.safety.checks.target_explanations import rank_explanations
from rcmservo.servo.state import State
from rcmservo.sim.arm import Drive
from rcmservo.sim.rig import RigSettings

SIZE = np.array([639.0, 479.0])

WRONG_TARGETS = {
    "mirrored left to right": lambda points: np.column_stack([639.0 - points[:, 0], points[:, 1]]),
    "mirrored top to bottom": lambda points: np.column_stack([points[:, 0], 479.0 - points[:, 1]]),
    "upside down": lambda points: SIZE - points,
    "camera was moved": lambda points: points + np.array([30.0, -40.0]),
    "marker 1 while teaching": lambda points: points + np.array([[15.0, -20.0], [0.0, 0.0]]),
    "marker 2 while teaching": lambda points: points + np.array([[0.0, 0.0], [-20.0, 15.0]]),
}
"""Pixels of a wrong target by those of the right one, and words of the first explanation."""

MOTION_S = 6.0


def run_to(lab: Laboratory, servo: rs.Servo, target: rs.Target) -> tuple[State, float]:
    """Run until a pause; return the last state, and how far the true error grew since exploration.

    The error (mm) is the distance of marker 2 from its position at the joints of teaching.
    """
    kinematics = lab.rig.settings.mechanism.to_struct(servo.tool.offset)
    p2_d = compute_second_marker(SHAFT, compute_position(kinematics, lab.target.q))
    lab.target, errors, state = target, list[float](), servo.init()
    for _, state in lab.run(servo, MOTION_S):
        if state.explored or state.phase is rs.Phase.PAUSED:
            p2 = lab.rig.truth.markers(lab.rig.clock.now())[1]
            errors.append(float(np.linalg.norm(p2 - p2_d)))
        if state.phase is rs.Phase.PAUSED:
            break
    return state, max(errors) - errors[0]


@pytest.mark.parametrize("estimator", mark_others_slow(["dlt", "fast", "flow"]))
@pytest.mark.parametrize("kind", WRONG_TARGETS)
def test_a_target_that_its_joints_contradict_stops_the_tool_after_exploration(
    kind: str, estimator: str
) -> None:
    for seed in (31, 47, 58):
        lab = make_laboratory(seed)
        wrong = replace(lab.target, points=WRONG_TARGETS[kind](lab.target.points))
        state, growth_mm = run_to(lab, lab.servo(estimator=ESTIMATORS[estimator]), wrong)
        assert state.phase is rs.Phase.PAUSED
        assert state.cause in (rs.Cause.IMPLAUSIBLE, rs.Cause.ELSEWHERE)
        assert growth_mm < 5.0
        assert kind in state.text.partition("probably because ")[2].partition(";")[0]


def test_without_the_check_a_mirrored_image_drives_the_tool_away() -> None:
    lab = make_laboratory(31)
    points = WRONG_TARGETS["mirrored left to right"](lab.target.points)
    servo = lab.servo(
        thresholds=rs.Thresholds(max_target_mismatch=np.inf),
        controller=rs.SaturatedController(joint_trust=0.0),
    )
    state, growth_mm = run_to(lab, servo, replace(lab.target, points=points))
    assert growth_mm > 9.0 and state.cause is not rs.Cause.IMPLAUSIBLE


IMPERFECT: dict[str, tuple[RigSettings, dict[str, Any]]] = {
    "none": (RigSettings(), {}),
    "1 px of noise": (RigSettings(point_noise=1.0), {}),
    "joints that are zero elsewhere": (
        RigSettings(drive=Drive(encoder_offset=(0.02, -0.02, 1.0))),
        {},
    ),
    "insertion 10 mm off": (RigSettings(), {"mechanism": rs.SphericalRcm(insertion_zero=10.0)}),
    "markers 33 mm apart": (RigSettings(), {"tool": rs.RigidTool(spacing=33.0)}),
}
"""Imperfections of rig and settings with which a servo reaches its target."""


@pytest.mark.parametrize("kind", IMPERFECT)
def test_the_imperfections_of_an_arm_contradict_no_target(kind: str) -> None:
    settings, parts = IMPERFECT[kind]
    for seed in (31, 47, 58):
        lab = make_laboratory(seed, settings)
        state, _ = run_to(lab, replace(lab.servo(), **parts), lab.target)
        assert state.cause is not rs.Cause.IMPLAUSIBLE, seed


@pytest.mark.parametrize("estimator", mark_others_slow(["dlt", "fast", "flow"]))
def test_the_image_confirms_each_few_mm_towards_a_target_without_joints(estimator: str) -> None:
    lab = make_laboratory(31)
    servo = lab.servo(estimator=ESTIMATORS[estimator])
    lab.target = replace(lab.target, q=np.full(3, np.nan))
    rows = [row for row in lab.run(servo, 10.0) if row[1].phase is rs.Phase.SERVO]
    assert all(state.cause is rs.Cause.TARGET_UNCHECKED for _, state in rows)
    path = lab.rig.settings.mechanism.to_struct(servo.tool.offset)
    times_s = np.array([observation.q_time for observation, _ in rows]) * 1e-9
    p1 = np.array([compute_position(path, observation.q) for observation, _ in rows])
    for markers in (p1, np.array([compute_second_marker(SHAFT, p) for p in p1])):
        moved_mm = np.linalg.norm(np.diff(markers, axis=0), axis=1)
        # at first the exploration's motion ends
        assert (moved_mm / np.diff(times_s))[30:].max() < 1.1 * UNCHECKED_TARGET_SPEED
    remaining_mm = [state.decision.remaining_mm for state in (rows[0][1], rows[-1][1])]
    assert remaining_mm[0] > 10.0 and remaining_mm[1] < 1.0


def test_a_target_without_joints_is_approached_fast_if_nothing_shall_compare_it() -> None:
    lab = make_laboratory(31)
    off = rs.Thresholds(max_target_mismatch=np.inf)
    state, _ = run_to(lab, lab.servo(thresholds=off), replace(lab.target, q=np.full(3, np.nan)))
    assert state.cause is rs.Cause.NONE


def test_a_target_that_is_taught_again_lets_the_tool_go_on() -> None:
    lab = make_laboratory(31)
    points = WRONG_TARGETS["upside down"](lab.target.points)
    wrong, requests = replace(lab.target, points=points), list[OperatorRequest]()

    def operate(tick: rs.Tick) -> OperatorRequest:
        paused = tick.state.cause is rs.Cause.IMPLAUSIBLE and not tick.state.command.rates.any()
        if paused and not requests:
            requests.append(Teach(5))
            return requests[0]
        return rs.Request.RESUME if tick.state.target != wrong else rs.Request.NONE

    *_, last = rs.servo_ticks(lab.plant, lab.servo(), wrong, MOTION_S, operator=operate)
    assert requests and last.state.phase is rs.Phase.SERVO


points_px = st.tuples(seeds, st.floats(20.0, 120.0))


def draw_markers(seed: int, length: float) -> Floats:
    """Return two markers (2, 2) px, `length` px apart and in no special direction."""
    random = make_random(seed)
    angle = random.integers(4) * np.pi / 2 + random.uniform(0.3, 1.2)
    first = random.uniform([100.0, 100.0], [540.0, 380.0])
    return np.stack([first, first + length * np.array([np.cos(angle), np.sin(angle)])])


@given(points_px, st.sampled_from(list(WRONG_TARGETS)))
def test_the_first_explanation_is_the_right_one(drawn: tuple[int, float], kind: str) -> None:
    predicted = draw_markers(*drawn)
    best, *others = rank_explanations(WRONG_TARGETS[kind](predicted), predicted)
    assert kind in best.text and best.residual_px < 1e-9
    assert all(one.residual_px > 1.0 for one in others)
