"""The simulated arm as what a motion controller drives."""

import numpy as np
import pytest

from rcmservo.method.kinematics import SphericalRcm
from rcmservo.sim.arm import Drive, SimulatedArm
from rcmservo.sim.motor_interface import ArmMotors

COUNTS = np.array([50000.0, -40000.0, 500.0])
SAMPLE = 1.0 / 1024.0
ON, OFF = [True] * 4, [False] * 4


def motors(q: list[float]) -> ArmMotors:
    arm = SimulatedArm(SphericalRcm(), Drive())
    arm.place(np.array(q))
    return ArmMotors(arm, COUNTS, 4)


def turned(motors: ArmMotors, speeds: list[float], on: list[bool], seconds: float) -> list[float]:
    for _ in range(round(seconds / SAMPLE)):
        counts = motors.step(speeds, on, SAMPLE)
    return list(counts)


def test_joints_turn_as_their_motors_do_with_the_signs_of_the_counts() -> None:
    it = motors([1.0, 0.2, 100.0])
    counts = turned(it, [5000.0, 4000.0, -5000.0, 9.0], ON, 1.0)
    moved = it.arm.q_true - [1.0, 0.2, 100.0]
    assert counts[:3] == pytest.approx([5000.0, 4000.0, -5000.0], rel=0.05)
    assert moved == pytest.approx(np.array(counts[:3]) / COUNTS, abs=2e-3)
    assert counts[3] == 0.0


def test_a_motor_that_is_off_stays_where_it_is_and_so_does_an_arm_without_any() -> None:
    it = motors([1.0, 0.2, 100.0])
    one = turned(it, [5000.0] * 4, [True, False, False, False], 0.5)
    assert one[0] > 2000.0 and one[1:] == [0.0, 0.0, 0.0]
    assert turned(it, [5000.0] * 4, OFF, 0.5)[0] == pytest.approx(one[0], abs=100.0)


@pytest.mark.parametrize(("joint", "way"), [(0, 1.0), (1, 1.0), (1, -1.0), (2, -1.0)])
def test_a_limit_switch_is_tripped_where_the_joint_is_at_its_end(joint: int, way: float) -> None:
    """Forward is where the counts rise."""
    it = motors([1.0, 0.2, 100.0])
    assert not any(forward or reverse for forward, reverse in it.switches())
    limits = it.arm.mechanism.limits
    q = np.array([1.0, 0.2, 100.0])
    q[joint] = (limits.upper if way > 0 else limits.lower)[joint]
    it.arm.place(q)
    forward, reverse = it.switches()[joint]
    rises = way * COUNTS[joint] > 0
    assert (forward, reverse) == (rises, not rises)
