"""Simulated arm as a motion controller drives it."""

import numpy as np
import pytest

from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.sim.arm import Drive, SimulatedArm
from rcmservo.sim.motor_interface import SimulatedMotors

COUNTS = np.array([50000.0, -40000.0, 500.0])
SAMPLE = 1.0 / 1024.0
ON, OFF = [True] * 4, [False] * 4


def motors(q: list[float]) -> SimulatedMotors:
    arm = SimulatedArm(SphericalRcm(), Drive())
    arm.place(np.array(q))
    return SimulatedMotors(arm, COUNTS, 4)


def turned(
    motors: SimulatedMotors, speeds: list[float], on: list[bool], seconds: float
) -> list[float]:
    for _ in range(round(seconds / SAMPLE)):
        counts = motors.step(speeds, on, SAMPLE)
    return list(counts)


def test_joints_follow_their_motors_with_the_signs_of_the_counts() -> None:
    interface = motors([1.0, 0.2, 100.0])
    counts = turned(interface, [5000.0, 4000.0, -5000.0, 9.0], ON, 1.0)
    moved = interface.arm.q_true - [1.0, 0.2, 100.0]
    assert counts[:3] == pytest.approx([5000.0, 4000.0, -5000.0], rel=0.05)
    assert moved == pytest.approx(np.array(counts[:3]) / COUNTS, abs=2e-3)
    assert counts[3] == 0.0


def test_a_motor_that_is_off_does_not_move() -> None:
    interface = motors([1.0, 0.2, 100.0])
    one = turned(interface, [5000.0] * 4, [True, False, False, False], 0.5)
    assert one[0] > 2000.0 and one[1:] == [0.0, 0.0, 0.0]
    assert turned(interface, [5000.0] * 4, OFF, 0.5)[0] == pytest.approx(one[0], abs=100.0)


@pytest.mark.parametrize(("joint", "direction"), [(0, 1.0), (1, 1.0), (1, -1.0), (2, -1.0)])
def test_a_limit_switch_is_active_at_the_end_of_its_joint(joint: int, direction: float) -> None:
    """Forward is the direction in which the counts rise."""
    interface = motors([1.0, 0.2, 100.0])
    assert not any(forward or reverse for forward, reverse in interface.switches())
    limits = interface.arm.mechanism.limits
    q = np.array([1.0, 0.2, 100.0])
    q[joint] = (limits.upper if direction > 0 else limits.lower)[joint]
    interface.arm.place(q)
    forward, reverse = interface.switches()[joint]
    rises = direction * COUNTS[joint] > 0
    assert (forward, reverse) == (rises, not rises)
