"""Backlash of the joints from the frames of a run: found where it is, and not found elsewhere."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import draw_calibration_matrix, make_random, project_markers, seeds
from rcmservo.control.backlash_fit import FRAME_COUNT_RANGE, compute_lost_motion, fit_backlash
from rcmservo.interfaces import Floats

SERVO = rs.Servo()
RCM, TOOL = SERVO.mechanism.to_struct(SERVO.tool.offset), SERVO.tool


@given(seeds, st.floats(0.01, 1.0))
def test_the_tool_follows_its_motor_at_most_half_the_backlash_away(
    seed: int, backlash: float
) -> None:
    q = np.cumsum(make_random(seed).normal(0.0, 0.2, 200))
    lost = compute_lost_motion(q, backlash)
    tool = q + lost
    assert np.abs(lost).max() <= 0.5 * backlash
    moved = np.diff(tool) != 0.0
    taken_up = np.abs(np.abs(lost[1:]) - 0.5 * backlash) < 1e-12
    assert np.all(taken_up[moved & (np.abs(np.diff(tool)) > 1e-12)])
    assert np.all(np.diff(tool) * np.diff(q) >= -1e-12)


def draw_path(random: np.random.Generator) -> Floats:
    """Return joints (n, 3) along legs between corners, as of an exploration and a way back."""
    start = np.array([0.5, 0.3, 100.0])
    corners = [start + random.uniform(-1, 1, 3) * [0.06, 0.06, 6.0] for _ in range(6)]
    ends = [start, *corners, start + np.array([0.2, -0.15, 20.0])]
    legs = [np.linspace(a, b, 15, endpoint=False) for a, b in pairwise(ends)]
    return np.vstack(legs)


def observe(q: Floats, backlash: Floats, random: np.random.Generator) -> Floats:
    """Return the markers (n, 2, 2) px, with 0.1 px of noise, for motors at q (n, 3)."""
    lost = [compute_lost_motion(q[:, j].copy(), backlash[j]) for j in range(3)]
    positions = np.array([SERVO.position_of_marker_1(joints) for joints in q + np.transpose(lost)])
    C = draw_calibration_matrix(random, positions)
    markers = np.array([project_markers(C, p1) for p1 in positions]).reshape(-1, 2, 2)
    return markers + 0.1 * random.standard_normal(markers.shape)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("backlash", [(0.006, 0.0, 0.0), (0.0, 0.006, 0.0), (0.004, 0.004, 0.4)])
def test_the_backlash_of_each_joint_is_found(seed: int, backlash: tuple[float, ...]) -> None:
    random, size = make_random(seed), np.array(backlash)
    q = draw_path(random)
    fit = fit_backlash(RCM, TOOL.struct, q, observe(q, size, random))
    assert fit is not None
    assert np.all(np.abs(fit.size - size) < 0.25 * size + 1e-9)


def test_too_few_frames_show_no_backlash() -> None:
    random = make_random(0)
    q = draw_path(random)[: FRAME_COUNT_RANGE[0] - 1]
    assert fit_backlash(RCM, TOOL.struct, q, observe(q, np.zeros(3), random)) is None
    assert fit_backlash(RCM, TOOL.struct, np.zeros((0, 3)), np.zeros((0, 2, 2))) is None


@pytest.mark.parametrize("value", [1e6, 0.0])
def test_markers_that_no_camera_shows_give_no_backlash(value: float) -> None:
    q = draw_path(make_random(0))
    points = np.full((len(q), 2, 2), value)
    points[::2] += make_random(1).uniform(-value, value, (len(points[::2]), 2, 2))
    fit = fit_backlash(RCM, TOOL.struct, q, points)
    assert fit is None or not fit.size.any()


def test_a_camera_that_moved_shows_no_backlash() -> None:
    random = make_random(0)
    q = draw_path(random)
    points = observe(q, np.full(3, 0.004), random)
    points[len(points) // 2 :] += 40.0
    assert fit_backlash(RCM, TOOL.struct, q, points) is None


@pytest.mark.parametrize(("size", "limit"), [(0.0, ""), (0.0087, "backlash of joint")])
def test_a_run_names_the_backlash_that_limits_its_pose(size: float, limit: str) -> None:
    arm = rs.sim.Imperfections(backlash=(size, size, 0.0))
    rig = rs.sim.Rig(4, rs.sim.RigSettings(imperfections=arm), pictures=False)
    result = rs.run(rig, rs.Servo(rig.mechanism, rig.tool), rig.teach(30), 4.0)
    assert result.settled and result.backlash is not None
    assert result.backlash[:2] == pytest.approx([size, size], rel=0.3)
    assert result.pose.limit.startswith(limit) if limit else "backlash of" not in result.pose.limit
