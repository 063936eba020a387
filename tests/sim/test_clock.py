"""Simulated clock and the arm's history: time passes only during waits."""

import numpy as np
import pytest

from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.interfaces import Clock, Command
from rcmservo.sim import Drive
from rcmservo.sim.arm import HISTORY_STEPS, PHYSICS_STEP_NS, SimulatedArm, SimulatedClock

START = np.array([0.2, -0.3, 100.0])
RATES = np.array([0.1, -0.2, 5.0])


@pytest.fixture
def arm() -> SimulatedArm:
    """Return an arm at START that moves all the time: it receives a command in every step."""
    made = SimulatedArm(SphericalRcm(), Drive())
    made.place(START)
    made.enable()
    made.before_step = lambda: command(made)
    return made


def command(arm: SimulatedArm) -> None:
    number = arm.time // PHYSICS_STEP_NS
    rates = RATES if number // 400 % 2 == 0 else -RATES
    arm.apply(Command(number, arm.time, arm.time + 20 * PHYSICS_STEP_NS, rates, enabled=True))


def test_time_passes_only_during_a_wait(arm: SimulatedArm) -> None:
    clock: Clock = SimulatedClock(arm)
    before = clock.now()
    assert clock.now() == before
    assert np.array_equal(arm.q_true, START)
    clock.wait_until(before + 50 * PHYSICS_STEP_NS)
    assert clock.now() == before + 50 * PHYSICS_STEP_NS
    assert arm.q_true[2] > START[2]


def test_a_stalled_process_wakes_later(arm: SimulatedArm) -> None:
    clock = SimulatedClock(arm)
    clock.stalls = lambda time: time + 30 * PHYSICS_STEP_NS
    clock.wait_until(clock.now() + PHYSICS_STEP_NS)
    assert clock.now() == 31 * PHYSICS_STEP_NS


def test_the_history_interpolates_the_joints_between_two_steps(arm: SimulatedArm) -> None:
    true = {arm.time: arm.q_true}
    for _ in range(100):
        arm.advance()
        true[arm.time] = arm.q_true
    for time, q in true.items():
        assert np.array_equal(arm.joints_at(time), q)
    one, two = true[90 * PHYSICS_STEP_NS], true[91 * PHYSICS_STEP_NS]
    assert np.allclose(
        arm.joints_at(90 * PHYSICS_STEP_NS + PHYSICS_STEP_NS // 4), 0.75 * one + 0.25 * two
    )


def test_for_earlier_times_the_history_returns_its_oldest_joints(arm: SimulatedArm) -> None:
    arm.advance_until((HISTORY_STEPS + 200) * PHYSICS_STEP_NS)
    oldest = arm.time - (HISTORY_STEPS - 1) * PHYSICS_STEP_NS
    assert np.array_equal(arm.joints_at(0), arm.joints_at(oldest))
    assert not np.array_equal(arm.joints_at(oldest), arm.joints_at(oldest + PHYSICS_STEP_NS))


def test_placing_the_arm_overwrites_its_history(arm: SimulatedArm) -> None:
    arm.advance_until(100 * PHYSICS_STEP_NS)
    arm.place(START)
    assert np.array_equal(arm.joints_at(50 * PHYSICS_STEP_NS), START)
