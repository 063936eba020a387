"""Pose-based control: the law, and a loop that moves an arm with it.

The loop has no phases and no faults; the law acts on each frame.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import compute_joint_rates
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.loop.clock import ticks
from rcmservo.paper.lab.calibration import Calibration
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import Servo
from rcmservo.study.simulation_engine import SimulationLoop


def saturated(error: Floats, bound: float) -> Floats:
    """Return an error vector with its norm limited to `bound`."""
    return error * min(1.0, bound / max(float(np.linalg.norm(error)), 1e-9))


@dataclass(frozen=True, eq=False)
class PoseLaw:
    """Pose-based control [20]: v = −k sat(p̂₁ − p̂₁d), with both positions from the calibration.

    Parameters
    ----------
    calibration : Calibration
        Calibration that locates marker 1; both fits start at the position by the present joints.
    robot : Servo
        Servo with the model of the tool.
    target : Target
        Target; the law uses only its pixels.
    gain : float
        Gain k in 1/s.
    bound : float
        Saturation of the error in mm.
    """

    calibration: Calibration
    robot: Servo
    target: Target
    gain: float
    bound: float = 20.0

    def velocity(self, points: Floats, p1: Floats) -> Floats:
        """Return v (3,) of marker 1 in mm/s, for raw pixels (2, 2) and p₁ (3,) in mm."""
        tool = self.robot.tool
        here, there = (
            self.calibration.locate(one, p1, tool) for one in (points, self.target.points)
        )
        return -self.gain * saturated(here - there, self.bound)


def drive(loop: SimulationLoop, robot: Servo, law: PoseLaw, duration: float) -> None:
    """Enable the drive, and control the arm with the law for `duration` s.

    Kinematics, gate and speed limit are those of `robot`. `loop.run` does not apply, because it
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
        rates = compute_joint_rates(robot.rcm, seen.q, v)
        command = robot.gate.admit(rates, command, seen.q, robot.rcm, seen.now).command
        plant.send(command)
        loop.record_tick(Phase.SERVO, Cause.NONE)


def _velocity(law: PoseLaw, robot: Servo, seen: Observation) -> Floats:
    """Return the velocity (3,) of the law in mm/s; zero if a marker is missing."""
    if not np.isfinite(seen.points).all():
        return np.zeros(3)
    v = law.velocity(seen.points, robot.position_of_marker_1(seen.q))
    return saturated(v, robot.controller.max_speed)
