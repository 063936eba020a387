"""Pose-based control: a law from a frame to a velocity, and the loop that drives an arm by it.

The law has no phases and no faults: it acts from its first frame to its last.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import joint_rates
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.loop.clock import ticks
from rcmservo.paper.lab.calibration import Calibration
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo
from rcmservo.study.simulation_engine import LaboratoryLoop


def saturated(error: Floats, bound: float) -> Floats:
    """Return an error shortened to `bound`, with its direction."""
    return error * min(1.0, bound / max(float(np.linalg.norm(error)), 1e-9))


@dataclass(frozen=True, eq=False)
class PoseLaw:
    """Pose-based control [20]: v = −k sat(p̂₁ − p̂₁d), both poses by the calibration.

    Parameters
    ----------
    calibration : Calibration
        Calibration that locates marker 1; the present joints give the first guess of both fits.
    robot : Servo
        Servo whose tool is used.
    target : Target
        Target, of which only the pixels are used.
    gain : float
        k, 1/s.
    bound : float
        Largest error in mm; a larger one is shortened to it.
    """

    calibration: Calibration
    robot: Servo
    target: Target
    gain: float
    bound: float = 20.0

    def velocity(self, points: Floats, p1: Floats) -> Floats:
        """Return v (3,) mm/s of marker 1, for raw pixels (2, 2) and p₁ (3,) mm by the joints."""
        tool = self.robot.tool
        here, there = (
            self.calibration.locate(one, p1, tool) for one in (points, self.target.points)
        )
        return -self.gain * saturated(here - there, self.bound)


def drive(loop: LaboratoryLoop, robot: Servo, law: PoseLaw, duration: float) -> None:
    """Enable the drive, and move by the law for `duration` s.

    The kinematics, the gate and the greatest speed are those of `robot`. No `loop.run`, which
    steps a servo.
    """
    plant = loop.plant
    plant.reset()
    plant.enable()
    command, v, frame = robot.gate.rest(), np.zeros(3), -1
    for _ in ticks(plant.clock, robot.rate, duration):
        seen = plant.read()
        if seen.frame > frame:
            frame, v = seen.frame, _velocity(law, robot, seen)
        rates = joint_rates(robot.rcm, seen.q, v)
        command = robot.gate.admit(rates, command, seen.q, robot.rcm, seen.now).command
        plant.send(command)
        loop.note(Phase.SERVO, Cause.NONE)


def _velocity(law: PoseLaw, robot: Servo, seen: Observation) -> Floats:
    """Return the law's velocity (3,) mm/s; zero where a marker is lost."""
    if not np.isfinite(seen.points).all():
        return np.zeros(3)
    v = law.velocity(seen.points, robot.marker_1(seen.q))
    return saturated(v, robot.controller.max_speed)
