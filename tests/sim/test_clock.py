"""Simulated time: it passes only while somebody waits, and the arm's past is known for a second."""

import numpy as np
import pytest

from rcmservo.interfaces import Clock, Command
from rcmservo.method.kinematics import SphericalRcm
from rcmservo.sim import Drive
from rcmservo.sim.arm import PAST, STEP, SimulatedArm, SimulatedClock

START = np.array([0.2, -0.3, 100.0])
RATES = np.array([0.1, -0.2, 5.0])


@pytest.fixture
def arm() -> SimulatedArm:
    """An arm at START that moves on and on: a command comes with every step."""
    made = SimulatedArm(SphericalRcm(), Drive())
    made.place(START)
    made.enable()
    made.before_step = lambda: command(made)
    return made


def command(arm: SimulatedArm) -> None:
    number = arm.time // STEP
    rates = RATES if number // 400 % 2 == 0 else -RATES
    arm.apply(Command(number, arm.time, arm.time + 20 * STEP, rates, enabled=True))


def test_time_passes_only_while_somebody_waits(arm: SimulatedArm) -> None:
    clock: Clock = SimulatedClock(arm)
    before = clock.now()
    assert clock.now() == before
    assert np.array_equal(arm.q_true, START)
    clock.wait_until(before + 50 * STEP)
    assert clock.now() == before + 50 * STEP
    assert arm.q_true[2] > START[2]


def test_a_process_that_is_held_up_wakes_later(arm: SimulatedArm) -> None:
    clock = SimulatedClock(arm)
    clock.stalls = lambda time: time + 30 * STEP
    clock.wait_until(clock.now() + STEP)
    assert clock.now() == 31 * STEP


def test_the_past_tells_where_the_joints_were_also_between_two_steps(arm: SimulatedArm) -> None:
    true = {arm.time: arm.q_true}
    for _ in range(100):
        arm.advance()
        true[arm.time] = arm.q_true
    for time, q in true.items():
        assert np.array_equal(arm.joints_at(time), q)
    one, two = true[90 * STEP], true[91 * STEP]
    assert np.allclose(arm.joints_at(90 * STEP + STEP // 4), 0.75 * one + 0.25 * two)


def test_before_the_last_second_the_past_tells_the_oldest_that_it_knows(arm: SimulatedArm) -> None:
    arm.advance_until((PAST + 200) * STEP)
    oldest = arm.time - (PAST - 1) * STEP
    assert np.array_equal(arm.joints_at(0), arm.joints_at(oldest))
    assert not np.array_equal(arm.joints_at(oldest), arm.joints_at(oldest + STEP))


def test_a_placed_arm_has_always_been_there(arm: SimulatedArm) -> None:
    arm.advance_until(100 * STEP)
    arm.place(START)
    assert np.array_equal(arm.joints_at(50 * STEP), START)
