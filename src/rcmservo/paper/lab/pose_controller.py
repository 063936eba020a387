"""Pose-based control, and a loop that moves an arm with it.

The loop has no phases and no faults; the controller acts on each frame.
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


@dataclass(frozen=True, eq=False)
class PoseController:
    """Pose-based control [20]: v = −k sat(p̂₁ − p̂₁d), with both positions from the calibration.

    Parameters
    ----------
    calibration : Calibration
        Calibration that locates marker 1; both fits start at the position by the present joints.
    servo : Servo
        Servo whose model of the tool, kinematics, gate and speed limit apply; it takes no step.
    target : Target
        Target; the controller uses only its pixels.
    gain : float
        Gain k in 1/s.
    bound : float
        Saturation of the error in mm.
    """

    calibration: Calibration
    servo: Servo
    target: Target
    gain: float
    bound: float = 20.0

    def control(self, loop: SimulationLoop, duration: float) -> None:
        """Enable the drive, and control the arm for `duration` s."""
        plant, servo = loop.plant, self.servo
        plant.reset()
        plant.enable()
        command, v, newest_frame = servo.gate.rest(), np.zeros(3), -1
        for _ in ticks(plant.clock, servo.rate, duration):
            observed = plant.read()
            if observed.frame > newest_frame:
                newest_frame, v = observed.frame, self.compute_velocity(observed)
            rates = compute_joint_rates(servo.rcm, observed.q, v)
            gate_arguments = (rates, command, observed.q, servo.rcm, observed.now)
            command = servo.gate.admit(*gate_arguments).command
            plant.send(command)
            loop.record_tick(Phase.SERVO, Cause.NONE)

    def compute_velocity(self, observed: Observation) -> Floats:
        """Return v (3,) of marker 1 in mm/s; zero if a marker is missing."""
        if not np.isfinite(observed.points).all():
            return np.zeros(3)
        p1, tool = self.servo.position_of_marker_1(observed.q), self.servo.tool
        here, desired = (
            self.calibration.locate(points, p1, tool)
            for points in (observed.points, self.target.points)
        )
        v = -self.gain * limit_norm(here - desired, self.bound)
        return limit_norm(v, self.servo.controller.max_speed)


def limit_norm(vector: Floats, bound: float) -> Floats:
    """Return a vector with its norm limited to `bound`."""
    return vector * min(1.0, bound / max(float(np.linalg.norm(vector)), 1e-9))
