"""Laws that are not the paper's, each from what one frame shows to a velocity of marker 1, and the
loop that drives an arm by them.

A law here knows no phases and no faults: it is on from its first frame to its last.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rcmservo.experiments.harness.lab.calibration import Calibration
from rcmservo.interfaces import Floats, Observation, Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.method.kinematics import joint_rates
from rcmservo.servo.servo import Servo


class Law(ABC):
    """From raw pixels to a velocity."""

    @abstractmethod
    def velocity(self, points: Floats, p1: Floats) -> Floats:
        """v (3,) mm/s of marker 1, for raw pixels (2, 2) and where the joints put marker 1, (3,)
        mm."""


def pseudo_inverse(L: Floats) -> Floats:
    """L⁺ of a matrix with more rows than columns and full rank."""
    return np.linalg.inv(L.T @ L) @ L.T


def saturated(error: Floats, bound: float) -> Floats:
    """An error shortened to `bound`, its direction kept."""
    return error * min(1.0, bound / max(float(np.linalg.norm(error)), 1e-9))


@dataclass(frozen=True, eq=False)
class PoseLaw(Law):
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
        tool = self.robot.tool
        here, wanted = (
            self.calibration.locate(one, p1, tool) for one in (points, self.target.points)
        )
        return -self.gain * saturated(here - wanted, self.bound)


@dataclass(frozen=True, eq=False)
class PointLaw(Law):
    """Point-based control on all four marker coordinates: v = −k L⁺ sat(m − m_d)."""

    jacobian: Callable[[Floats], Floats]
    """L (4, 3) px/mm for marker 1 at p₁ (3,) mm."""
    target: Target
    """Its raw pixels are m_d."""
    gain: float
    """k, 1/s."""
    bound: float = 50.0
    """px to which an error is shortened."""

    def velocity(self, points: Floats, p1: Floats) -> Floats:
        error = saturated((points - self.target.points).ravel(), self.bound)
        return -self.gain * pseudo_inverse(self.jacobian(p1)) @ error


def drive(plant: Plant, robot: Servo, law: Law, duration: float) -> Iterator[float]:
    """Switch the drive on, move by the law, and yield the time s of every tick.

    `robot` lends what the robot knows of itself, its gate, and the greatest speed of its own law.
    """
    plant.reset()
    plant.enable()
    command, v, frame = robot.gate.rest(), np.zeros(3), -1
    try:
        for time in ticks(plant.clock, robot.rate, duration):
            seen = plant.read()
            if seen.frame > frame:
                frame, v = seen.frame, _wanted(law, robot, seen)
            rates = joint_rates(robot.rcm, seen.q, v)
            command = robot.gate.admit(rates, command, seen.q, robot.rcm, seen.now).command
            plant.send(command)
            yield time / 1e9
    finally:
        plant.send(robot.gate.stop(command, plant.clock.now()))


def _wanted(law: Law, robot: Servo, seen: Observation) -> Floats:
    """The law's velocity (3,) mm/s; none where a marker is lost."""
    if not np.isfinite(seen.points).all():
        return np.zeros(3)
    v = law.velocity(seen.points, robot.marker_1(seen.q))
    return saturated(v, robot.controller.max_speed)


@dataclass(frozen=True)
class Seen:
    """What an exploration showed, frame by frame."""

    p1: Floats
    """(n, 3) mm, p₁ by the joints."""
    m: Floats
    """(n, 4) px, the raw pixels seen there."""

    def constant_jacobian(self) -> Floats:
        """The one L (4, 3) px/mm that explains the pixels best: m ≈ m₀ + L (p₁ − p₀), by least
        squares."""
        p, m = self.p1 - self.p1.mean(axis=0), self.m - self.m.mean(axis=0)
        return (pseudo_inverse(p) @ m).T
