"""Calibrations of the camera that are handed over: exact, wrong, or from before it was rolled.

They are calibrations of a pinhole: the distortion of the simulated lens stays unknown, as it would
to anyone who has the matrix C alone.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_rule import jacobian_at, markers_jacobian, predict
from rcmservo.geometry.features import about
from rcmservo.geometry.projection import parameters
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel

SCIPY: Any = optimize
"""SciPy's optimisers without types."""


Quality = Literal["exact", "wrong", "rolled"]
FOCAL_ERROR = 0.05
"""Relative error of the focal length of a wrong calibration."""
TURN_DEG = 5.0
"""° by which the camera of a wrong calibration is turned."""
SHIFT_MM = 10.0
"""mm by which it is moved."""
ROLL_DEG = 90.0
"""° by which the camera was rolled after it had been calibrated."""
WRONG = (
    f"f {100 * FOCAL_ERROR:g} % off, the camera turned by {TURN_DEG:g}° and moved by "
    f"{SHIFT_MM:g} mm"
)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Parameters of a calibration matrix C (3, 4) by Lemma 1.

    Parameters
    ----------
    a : Floats
        Nine parameters (9,).
    o_c : Floats
        Image of the RCM, (2,) px.
    """

    a: Floats
    o_c: Floats

    def locate(self, points: Floats, guess: Floats, tool: Tool) -> Floats:
        """Return p̂₁ (3,) mm from raw pixels (2, 2), by least squares from a first guess (3,)."""
        m = about(points, self.o_c)

        def residual(p1: Floats) -> Floats:
            return predict(self.a, p1, tool.shaft) - m

        def jacobian(p1: Floats) -> Floats:
            return self.points_jacobian(p1, tool)

        found, _ = SCIPY.leastsq(residual, guess, Dfun=jacobian, ftol=1e-8, xtol=1e-8)
        return found

    def points_jacobian(self, p1: Floats, tool: Tool) -> Floats:
        """Return ∂m/∂p₁ (4, 3) px/mm of both markers with marker 1 at p1 (3,) mm."""
        return markers_jacobian(self.a, p1, tool.shaft)


def exact(optics: CameraModel) -> Calibration:
    """Return the true camera as a pinhole."""
    return Calibration(*parameters(optics.pinhole()))


def handed_over(quality: Quality, optics: CameraModel, random: np.random.Generator) -> Calibration:
    """Return a calibration of the true camera.

    A wrong one has a focal length too long or too short, and a camera turned and moved in random
    directions. A rolled one is from before the camera was rolled about its line of sight.
    """
    if quality == "exact":
        return exact(optics)
    if quality == "rolled":
        back = Rotation.from_rotvec([0.0, 0.0, float(np.radians(ROLL_DEG))]).as_matrix()
        return exact(replace(optics, rotation=back @ optics.rotation))
    longer = random.choice([-1.0, 1.0]) * FOCAL_ERROR
    turn, shift = (size * _direction(random) for size in (float(np.radians(TURN_DEG)), SHIFT_MM))
    rotation = Rotation.from_rotvec(turn).as_matrix() @ optics.rotation
    focal, position = (1.0 + longer) * optics.focal, optics.position + shift
    return exact(replace(optics, focal=focal, rotation=rotation, position=position))


def _direction(random: np.random.Generator) -> Floats:
    way = random.standard_normal(3)
    return way / np.linalg.norm(way)


@dataclass(frozen=True, eq=False)
class Calibrated(Estimator):
    """Ĵ of (15) from given parameters, the traditional approach [12], which estimates nothing.

    Parameters
    ----------
    calibration : Calibration
        Source of ``a``; o_c, about which the features are measured, stays the servo's own.
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

    def motion(self, memory: None, tool: Tool, sample: Sample) -> Floats:
        return self.calibration.points_jacobian(sample.p1, tool)
