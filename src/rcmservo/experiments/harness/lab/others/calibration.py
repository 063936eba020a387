"""What a person who calibrated the camera hands over: exact, wrong, or from before it was rolled.

It is the calibration of a pinhole: what distortion the simulated lens has stays unknown to it, as
it would to anybody who has the matrix C alone.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from rcmservo.interfaces import Floats
from rcmservo.method.estimators.base import Estimator, Sample
from rcmservo.method.estimators.projection import jacobian_at, markers_jacobian, predict
from rcmservo.method.features import about
from rcmservo.method.projection import parameters
from rcmservo.method.tool import Tool
from rcmservo.sim.optics import Optics

SCIPY: Any = optimize
"""SciPy's optimisers without types."""


Quality = Literal["exact", "wrong", "rolled"]


@dataclass(frozen=True)
class Miscalibration:
    """How wrong a calibration is."""

    focal: float = 0.05
    """Share by which the focal length is off."""
    turn: float = float(np.radians(5.0))
    """rad by which the camera is turned."""
    shift: float = 10.0
    """mm by which it is moved."""

    @property
    def words(self) -> str:
        return (
            f"f {100 * self.focal:g} % off, the camera turned by {np.degrees(self.turn):g}° and "
            f"moved by {self.shift:g} mm"
        )


@dataclass(frozen=True, eq=False)
class Calibration:
    """The parameters of a calibration matrix C (3, 4) by Lemma 1."""

    a: Floats
    """The nine parameters (9,)."""
    o_c: Floats
    """Where it puts the RCM, (2,) px."""

    def locate(self, points: Floats, guess: Floats, tool: Tool) -> Floats:
        """p̂₁ (3,) mm from raw pixels (2, 2): least squares over the four coordinates, from a first
        guess (3,)."""
        m = about(points, self.o_c)

        def left(p1: Floats) -> Floats:
            return predict(self.a, p1, tool.shaft) - m

        def jacobian(p1: Floats) -> Floats:
            return self.points_jacobian(p1, tool)

        found, _ = SCIPY.leastsq(left, guess, Dfun=jacobian, ftol=1e-8, xtol=1e-8)
        return found

    def points_jacobian(self, p1: Floats, tool: Tool) -> Floats:
        """∂m/∂p₁ (4, 3) px/mm of both markers with marker 1 at p1 (3,) mm."""
        return markers_jacobian(self.a, p1, tool.shaft)


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


def handed_over(
    quality: Quality, optics: Optics, by: Miscalibration, roll: float, random: np.random.Generator
) -> Calibration:
    """What a person hands over of the true camera: exact, wrong in random directions, or from
    before a roll."""
    if quality == "exact":
        return exact(optics)
    return rolled(optics, roll) if quality == "rolled" else wrong(optics, by, random)


def _direction(random: np.random.Generator) -> Floats:
    way = random.standard_normal(3)
    return way / np.linalg.norm(way)


@dataclass(frozen=True, eq=False)
class Calibrated(Estimator):
    """Ĵ of (15) from given parameters, the traditional approach [12]: nothing is learnt."""

    calibration: Calibration
    """Its ``a`` alone is used: o_c, about which the features are measured, stays the servo's
    own."""

    name = "calibrated"
    models = False

    def init(self) -> None:
        return None

    def update(self, memory: None, tool: Tool, sample: Sample) -> None:
        return None

    def jacobian(self, memory: None, tool: Tool, sample: Sample) -> Floats:
        return jacobian_at(self.calibration.a, sample.p1, sample.points, sample.o_c, tool.shaft)

    def motion(self, memory: None, tool: Tool, sample: Sample) -> Floats:
        return self.calibration.points_jacobian(sample.p1, tool)
