"""Approach of the target from one side, so that backlash is taken up at the target."""

from dataclasses import replace

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.interfaces import Floats

ANGLE_STEP, LENGTH_STEP = 2e-4, 0.02
"""Largest motion (rad, mm) of a joint against the direction of its arrival, by noise."""


def run(seed: int, approach: tuple[float, float, float], has_joints: bool = True) -> list[rs.Tick]:
    """Return the ticks of a run with 0.05 px of noise to a target with or without joints."""
    rig = rs.sim.Rig(seed, rs.sim.RigSettings(point_noise=0.05), pictures=False)
    target, ticks = rig.teach(300), list[rs.Tick]()
    if not has_joints:
        target = replace(target, q=np.full(3, np.nan))

    def watch(tick: rs.Tick) -> rs.Request:
        ticks.append(tick)
        return rs.Request.NONE

    controller = rs.SaturatedController(approach=approach)
    servo = rs.Servo(rig.mechanism, rig.tool, controller=controller)
    result = rs.run(rig, servo, target, 12.0, operator=watch)
    assert result.settled
    assert not has_joints or result.pose_error_mm < 0.3  # type: ignore[operator]
    return ticks


def joints_after_approach(ticks: list[rs.Tick]) -> Floats:
    decisions = [tick.state.stored.decision for tick in ticks]
    first = next(k for k, decision in enumerate(decisions) if decision.has_approached)
    return np.array([tick.observation.q for tick in ticks[first:]])


@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, -1)])
def test_each_joint_arrives_from_the_side_of_its_offset(
    seed: int, signs: tuple[int, int, int]
) -> None:
    offset = np.array(signs) * [0.015, 0.015, 1.0]
    ticks = run(seed, (float(offset[0]), float(offset[1]), float(offset[2])))
    assert any(tick.state.stored.decision.aims_at_approach for tick in ticks)
    arrival = joints_after_approach(ticks) * signs
    assert np.all(arrival[0] - arrival[-1] > 0.5 * np.abs(offset)), "it comes from that side"
    against = arrival[-1] - arrival.min(axis=0)
    assert np.all(against < [ANGLE_STEP, ANGLE_STEP, LENGTH_STEP]), "and does not turn back"


def test_without_an_offset_the_tool_goes_to_the_target_directly() -> None:
    assert not any(t.state.stored.decision.aims_at_approach for t in run(0, (0.0, 0.0, 0.0)))


def test_a_target_without_joints_is_approached_directly() -> None:
    ticks = run(0, (0.015, 0.015, 1.0), has_joints=False)
    assert not any(tick.state.stored.decision.aims_at_approach for tick in ticks)


@pytest.mark.parametrize("approach", [(0.2, 0.0, 0.0), (0.0, 0.0, 10.1), (0.0, np.nan, 0.0)])
def test_offsets_beyond_a_short_way_are_refused(approach: tuple[float, float, float]) -> None:
    with pytest.raises(rs.BadInput, match=r"controller\.approach must be three offsets"):
        rs.SaturatedController(approach=approach)
