"""Calibrations of the camera for methods that need one: exact, wrong, or outdated by a roll.

They describe a pinhole camera. The distortion of the simulated lens stays unknown, because the
matrix C does not contain it.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.projection_rule import (
    compute_jacobian_at_points,
    compute_markers_jacobian,
    predict_markers,
)
from rcmservo.geometry.features import shift_to_rcm
from rcmservo.geometry.projection import extract_parameters
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel

SCIPY: Any = optimize
"""SciPy's optimisers, which have no type annotations."""


Quality = Literal["exact", "wrong", "rolled"]
FOCAL_ERROR = 0.05
"""Relative error of the focal length of a wrong calibration."""
TURN_DEG = 5.0
"""Error (°) of the orientation of a wrong calibration."""
SHIFT_MM = 10.0
"""Error (mm) of the position of a wrong calibration."""
ROLL_DEG = 90.0
"""Angle (°) by which the camera was rolled after an outdated calibration."""
WRONG_CALIBRATION = (
    f"errors of {100 * FOCAL_ERROR:g} % in f, {TURN_DEG:g}° in the orientation and "
    f"{SHIFT_MM:g} mm in the position of the camera"
)
"""Description of a wrong calibration."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Parameters of a calibration matrix C (3, 4) by Lemma 1.

    Parameters
    ----------
    a : Floats
        Parameters (9,).
    o_c : Floats
        Imaged RCM (2,) in px.
    """

    a: Floats
    o_c: Floats

    def locate(self, points: Floats, guess: Floats, tool: Tool) -> Floats:
        """Return p̂₁ (3,) in mm from raw pixels (2, 2), by least squares from `guess` (3,)."""
        m, tool_struct = shift_to_rcm(points, self.o_c), tool.struct

        def residual(p1: Floats) -> Floats:
            return predict_markers(self.a, p1, tool_struct) - m

        def jacobian(p1: Floats) -> Floats:
            return compute_markers_jacobian(self.a, p1, tool_struct)

        p1_hat, _ = SCIPY.leastsq(residual, guess, Dfun=jacobian, ftol=1e-8, xtol=1e-8)
        return p1_hat


def exact_calibration(optics: CameraModel) -> Calibration:
    """Return the true camera as a pinhole, without its distortion."""
    return Calibration(*extract_parameters(optics.pinhole()))


def make_calibration(
    quality: Quality, optics: CameraModel, random: np.random.Generator
) -> Calibration:
    """Return a calibration of the true camera with a certain quality.

    A wrong one has a focal length too long or too short, and errors of orientation and position in
    random directions. A rolled one predates a roll of the camera about its optical axis.
    """
    if quality == "exact":
        return exact_calibration(optics)
    if quality == "rolled":
        back = Rotation.from_rotvec([0.0, 0.0, float(np.radians(ROLL_DEG))]).as_matrix()
        return exact_calibration(replace(optics, rotation=back @ optics.rotation))
    sign = random.choice([-1.0, 1.0])
    turn, shift = (
        size * _draw_direction(random) for size in (float(np.radians(TURN_DEG)), SHIFT_MM)
    )
    rotation = Rotation.from_rotvec(turn).as_matrix() @ optics.rotation
    focal, position = (1.0 + sign * FOCAL_ERROR) * optics.focal, optics.position + shift
    return exact_calibration(replace(optics, focal=focal, rotation=rotation, position=position))


def _draw_direction(random: np.random.Generator) -> Floats:
    direction = random.standard_normal(3)
    return direction / np.linalg.norm(direction)


@dataclass(frozen=True, eq=False)
class CalibratedEstimator(Estimator):
    """Ĵ of (15) from known parameters: the traditional approach [12], without estimation.

    Parameters
    ----------
    calibration : Calibration
        Calibration with the parameters ``a``. The servo still estimates o_c.
    """

    calibration: Calibration

    name = "calibrated"
    predicts_markers = False

    def init(self) -> None:
        return None

    def update(self, memory: None, tool: Tool, sample: Sample) -> None:
        return None

    def jacobian(self, memory: None, tool: Tool, sample: Sample) -> Floats:
        return compute_jacobian_at_points(
            self.calibration.a, sample.p1, sample.points, sample.o_c, tool.struct
        )

    def markers_jacobian(self, memory: None, tool: Tool, sample: Sample) -> Floats:
        return compute_markers_jacobian(self.calibration.a, sample.p1, tool.struct)
