"""Joints that rest at small rates, by a dead zone or stiction: no fault near the target.

The rates are mm/s, and as many 0.01 rad/s of the hinges.
"""

from typing import Any

import numpy as np
import pytest

import rcmservo as rs
from rcmservo.sim import Drive, RigSettings

UNITS = np.array([0.01, 0.01, 1.0])


def run_resting(seed: int, gain: float = rs.SaturatedController().gain, **rates: float) -> Any:
    """Return the result of a run with drives that rest at small rates, and its last tick."""
    settings = {name: tuple(rate * UNITS) for name, rate in rates.items()}
    rig = rs.sim.Rig(seed, RigSettings(drive=Drive(**settings)), pictures=False)  # type: ignore[arg-type]
    ticks: list[rs.Tick] = []

    def watch(tick: rs.Tick) -> rs.Request:
        ticks.append(tick)
        return rs.Request.NONE

    servo = rs.Servo(controller=rs.SaturatedController(gain=gain))
    result = rs.run(rig, servo, rig.teach(30), 10.0, operator=watch)
    return result, ticks[-1]


@pytest.mark.parametrize("seed", [3, 11])
@pytest.mark.parametrize("rates", [{"deadband": 1.0}, {"deadband": 2.0}, {"stiction": 2.0}])
def test_an_arm_whose_joints_rest_at_small_rates_arrives(
    seed: int, rates: dict[str, float]
) -> None:
    result, last = run_resting(seed, **rates)
    assert result.settled and last.state.cause is rs.Cause.NONE
    assert result.pose_error_mm < 1.0 and result.pose_error_mm < result.pose.bound_mm


def test_the_bound_names_the_joint_that_rests_and_its_rate() -> None:
    result, last = run_resting(3, deadband=2.0)
    joint = int(np.argmax(last.state.resting_rates / UNITS))
    rate = last.state.resting_rates[joint] / UNITS[joint]
    assert 1.0 < rate <= 2.0  # within a factor of two
    assert f"joint {joint + 1} (" in result.pose.limit and "rests at up to" in result.pose.limit


def test_the_bound_of_joints_that_move_is_limited_by_something_else() -> None:
    result, last = run_resting(3)
    assert "arm, tool and lens" in result.pose.limit
    assert (last.state.resting_rates < 0.05 * UNITS).all()
    rig = rs.sim.Rig(3, RigSettings(point_noise=0.05), pictures=False)
    assert "noise of the markers" in rs.run(rig, rs.Servo(), rig.teach(30), 8.0).pose.limit


def test_before_arrival_the_parts_of_the_bound_are_unknown_as_the_bound_is() -> None:
    state = rs.Servo().init()
    assert np.isnan(state.pose_bound) and np.isnan(state.bound_parts).all()


def test_a_joint_that_rests_far_from_the_target_is_a_fault_with_its_rate() -> None:
    """With a small gain the rates are small farther away. The joint could be blocked."""
    result, last = run_resting(5, gain=2.0, deadband=2.0)
    assert last.state.cause is rs.Cause.NOT_FOLLOWING, result
    assert "rests at rates up to" in last.state.text
