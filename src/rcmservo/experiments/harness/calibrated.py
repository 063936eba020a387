"""What needs a calibrated camera: the traditional image-based law [12] and pose-based control [20],
as baselines.

A `Calibration` is handed over from outside, as a person who calibrated the camera would. It is that
of a pinhole: what distortion the simulated lens has stays unknown to it, as it would to anybody who
has the matrix C alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from rcmservo.interfaces import Floats, Target
from rcmservo.loop.clock import ticks
from rcmservo.loop.plant import Plant
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.projection import jacobian_at, markers_jacobian, predict
from rcmservo.method.features import about
from rcmservo.method.kinematics import joint_rates
from rcmservo.method.projection import parameters
from rcmservo.method.tool import Tool
from rcmservo.servo.servo import Servo
from rcmservo.sim.optics import Optics

SCIPY: Any = optimize
"""SciPy's optimisers without types."""


@dataclass(frozen=True)
class Miscalibration:
    """How wrong a calibration is: ``focal`` as a share, the camera turned by ``turn`` rad and moved
    by ``shift`` mm."""

    focal: float = 0.05
    turn: float = float(np.radians(5.0))
    shift: float = 10.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """The parameters a (9,) of a calibration matrix C (3, 4), and where it puts the RCM, o_c (2,)
    px: Lemma 1."""

    a: Floats
    o_c: Floats

    def locate(self, points: Floats, guess: Floats, tool: Tool) -> Floats:
        """p̂₁ (3,) mm from raw pixels (2, 2): least squares over the four coordinates, from a first
        guess (3,)."""
        m = about(points, self.o_c)

        def left(p1: Floats) -> Floats:
            return predict(self.a, p1, tool.shaft) - m

        def jacobian(p1: Floats) -> Floats:
            return markers_jacobian(self.a, p1, tool.shaft)

        return SCIPY.least_squares(left, guess, jac=jacobian, method="lm").x


def exact(optics: Optics) -> Calibration:
    """The true camera as a pinhole."""
    return Calibration(*parameters(optics.pinhole()))


def wrong(optics: Optics, by: Miscalibration, random: np.random.Generator) -> Calibration:
    """The true camera miscalibrated: focal length too long or too short, turned and moved in random
    directions."""
    longer = random.choice([-1.0, 1.0]) * by.focal
    turn, shift = (size * _direction(random) for size in (by.turn, by.shift))
    rotation = Rotation.from_rotvec(turn).as_matrix() @ optics.rotation
    focal, position = (1.0 + longer) * optics.focal, optics.position + shift
    return exact(replace(optics, focal=focal, rotation=rotation, position=position))


def rolled(optics: Optics, roll: float) -> Calibration:
    """An exact calibration from before somebody rolled the camera by `roll` rad about its line of
    sight."""
    back = Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
    return exact(replace(optics, rotation=back @ optics.rotation))


def _direction(random: np.random.Generator) -> Floats:
    way = random.standard_normal(3)
    return way / np.linalg.norm(way)


@dataclass(frozen=True, eq=False)
class Calibrated(Estimator):
    """Ĵ of (15) from given parameters, the traditional approach [12]: nothing is learnt.

    o_c, about which the features are measured, stays the servo's own.
    """

    calibration: Calibration

    name = "calibrated"
    models = False

    def init(self) -> None:
        return None

    def update(self, memory: None, tool: Tool, sample: Sample) -> None:
        return None

    def jacobian(self, memory: None, tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(self.calibration.a, sample.p1, sample.points, sample.o_c, tool.shaft)


@dataclass(frozen=True)
class PoseLaw:
    """v = −k sat(p̂₁ − p̂₁d) with ``gain`` k 1/s; sat shortens an error to ``bound`` mm and keeps
    its direction."""

    gain: float = 2.0
    bound: float = 20.0

    def velocity(self, error: Floats) -> Floats:
        """v (3,) mm/s of marker 1 for an error (3,) mm."""
        return -self.gain * error * min(1.0, self.bound / max(float(np.linalg.norm(error)), 1e-9))


def pose_based(
    plant: Plant,
    robot: Servo,
    calibration: Calibration,
    law: PoseLaw,
    target: Target,
    duration: float,
) -> Iterator[float]:
    """Servo to the pose in which the calibration sees the target, and yield the time s of every
    tick.

    `robot` lends what the robot knows of itself, and its gate. Its joints give the first guess of
    every fit; how they were while the target was shown is not used.
    """
    command, v, frame, p1_d = robot.gate.rest(), np.zeros(3), -1, None
    for time in ticks(plant.clock, duration=duration):
        seen = plant.read()
        if seen.frame > frame:
            frame, v = seen.frame, np.zeros(3)
            if np.isfinite(seen.points).all():
                guess = robot.marker_1(seen.q)
                if p1_d is None:
                    p1_d = calibration.locate(target.points, guess, robot.tool)
                v = law.velocity(calibration.locate(seen.points, guess, robot.tool) - p1_d)
        rates = joint_rates(robot.rcm, seen.q, v)
        command = robot.gate.admit(rates, command, seen.q, robot.rcm, seen.now).command
        plant.send(command)
        yield time / 1e9
