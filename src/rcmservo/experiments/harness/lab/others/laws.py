"""A law that is no servo's, from what one frame shows to a velocity of marker 1, and the loop that
drives an arm by it.

A law here knows no phases and no faults: it is on from its first frame to its last.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.experiments.harness.lab.others.calibration import Calibration
from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.loop.clock import ticks
from rcmservo.method.kinematics import joint_rates
from rcmservo.servo.servo import Servo
from rcmservo.study.laboratory import LaboratoryLoop


def saturated(error: Floats, bound: float) -> Floats:
    """An error shortened to `bound`, its direction kept."""
    return error * min(1.0, bound / max(float(np.linalg.norm(error)), 1e-9))


@dataclass(frozen=True, eq=False)
class PoseLaw:
    """Pose-based control [20]: v = −k sat(p̂₁ − p̂₁d), both poses as the calibration sees them."""

    calibration: Calibration
    """It locates marker 1; the joints of now give the first guess of both fits."""
    robot: Servo
    """It lends the tool, as the robot knows it."""
    target: Target
    """Its pixels alone are used, not the joints at which it was shown."""
    gain: float
    """k, 1/s."""
    bound: float = 20.0
    """mm to which an error is shortened."""

    def velocity(self, points: Floats, p1: Floats) -> Floats:
        """v (3,) mm/s of marker 1, for raw pixels (2, 2) and where the joints put marker 1, (3,)
        mm."""
        tool = self.robot.tool
        here, wanted = (
            self.calibration.locate(one, p1, tool) for one in (points, self.target.points)
        )
        return -self.gain * saturated(here - wanted, self.bound)


def drive(loop: LaboratoryLoop, robot: Servo, law: PoseLaw, duration: float) -> None:
    """Switch the drive on, and move by the law for `duration` s.

    `robot` lends what the robot knows of itself, its gate, and the greatest speed of its own law.
    """
    plant = loop.plant
    plant.reset()
    plant.enable()
    command, v, frame = robot.gate.rest(), np.zeros(3), -1
    for _ in ticks(plant.clock, robot.rate, duration):
        seen = plant.read()
        if seen.frame > frame:
            frame, v = seen.frame, _wanted(law, robot, seen)
        rates = joint_rates(robot.rcm, seen.q, v)
        command = robot.gate.admit(rates, command, seen.q, robot.rcm, seen.now).command
        plant.send(command)
        loop.note(Phase.SERVO, Cause.NONE)


def _wanted(law: PoseLaw, robot: Servo, seen: Observation) -> Floats:
    """The law's velocity (3,) mm/s; none where a marker is lost."""
    if not np.isfinite(seen.points).all():
        return np.zeros(3)
    v = law.velocity(seen.points, robot.marker_1(seen.q))
    return saturated(v, robot.controller.max_speed)
