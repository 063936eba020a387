"""Scene: camera, start and target, and the settings of their random distributions.

scenes/sampling.py samples a scene from the settings.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, Limit, Triple, angles, each, finite, not_negative
from rcmservo.errors import RcmServoError
from rcmservo.geometry.kinematics import FULL_TURN_RAD
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.tool_body import ToolBody

Range = tuple[float, float]
"""Least and greatest value of a distribution."""

POSITIVE_RANGE = Limit(
    lambda ends: 0.0 < ends[0] <= ends[1] < np.inf, "two positive numbers, least first"
)
ELEVATION_RANGE = Limit(
    lambda ends: -1.5 <= ends[0] <= ends[1] <= 1.5, "two angles from -1.5 to 1.5 rad, least first"
)
INITIAL_ERROR_LIMIT = Limit(
    lambda errors: bool(np.isfinite(errors).all()) and any(errors),
    "three finite numbers (rad, px, px), not all zero",
)
JOINT_VALUES_LIMIT = each(finite(), "three finite joint values (rad, rad, mm)")


class NoScene(RcmServoError):
    """Failure of the sampling: no scene within the settings was found."""


@dataclass(frozen=True)
class SceneSettings(Checked, section="scene"):
    """Distributions from which scenes are sampled.

    A pair of numbers is (least, greatest) of a uniform distribution.

    Parameters
    ----------
    focal : Range
        Focal length of the camera, px, positive.
    distance : Range
        Distance from the camera to the tool, mm, positive.
    elevation : Range
        Elevation (rad) of the camera above the tool, from -1.5 to 1.5. Down is the direction from
        the RCM straight into the body.
    ports : Range or None
        Distance (mm) from the tool's port, which is the RCM, to the port of an endoscope. The
        camera is then inside the body, ``distance`` from the tool. ``elevation`` and the limits of
        the condition number have no effect, because the RCM may be behind the camera. None: the
        camera is anywhere around the tool, with the RCM in front of it.
    distortion : Range
        Radial distortion k₁ and k₂ of the lens, which are not sampled.
    travel : Range
        Distance from start to target, mm, positive.
    insertion : Range
        Distance (mm) of marker 1 from the RCM at the start, positive.
    max_condition : float
        Largest condition number of the scaled Jacobian on the straight path to the target, above 1.
    min_condition : float
        Condition number that is exceeded somewhere on that path, from 0 to below ``max_condition``.
        40 with an unlimited ``max_condition`` gives the hard scenes that the default excludes.
    room : float
        Distance (mm) that both markers can move from the start without leaving the image, so that
        the servo can explore; not negative.
    errors : Triple or None
        Initial error Δy = y − y_d (rad, px, px), not all zero. The path is then that of the
        saturated controller, eq. (33), and ``room`` also holds at its midpoint.
    start : Triple or None
        Joints (rad, rad, mm) of the start; None samples them. If start and target are both given,
        the scene only has to show both markers.
    target : Triple or None
        Joints (rad, rad, mm) of the target; None samples them.

    Raises
    ------
    BadInput
        If a field is outside its range or contradicts another one.
    """

    focal: Annotated[Range, POSITIVE_RANGE] = (500.0, 900.0)

    distance: Annotated[Range, POSITIVE_RANGE] = (120.0, 300.0)

    elevation: Annotated[Range, ELEVATION_RANGE] = (-0.2, 0.9)

    ports: Annotated[Range | None, POSITIVE_RANGE] = None

    distortion: Annotated[Range, each(finite(), "two finite numbers k1, k2")] = (-0.08, 0.02)

    travel: Annotated[Range, POSITIVE_RANGE] = (20.0, 60.0)

    insertion: Annotated[Range, POSITIVE_RANGE] = (70.0, 150.0)

    max_condition: Annotated[float, Limit(lambda x: x > 1.0, "a number above 1")] = 40.0

    min_condition: float = 0.0

    room: Annotated[float, not_negative("length in mm")] = 10.0

    errors: Annotated[Triple | None, INITIAL_ERROR_LIMIT, angles(np.pi, first=1)] = None

    start: Annotated[Triple | None, JOINT_VALUES_LIMIT, angles(FULL_TURN_RAD, first=2)] = None

    target: Annotated[Triple | None, JOINT_VALUES_LIMIT, angles(FULL_TURN_RAD, first=2)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.errors is not None:
            is_sampled = self.start is None and self.target is None
            self.require(is_sampled, "errors", "left out where start or target is given")
            expected = "left out where ports are given: the RCM may be unseen"
            self.require(self.ports is None, "errors", expected)
        expected = f"a number from 0 to below max_condition = {self.max_condition}"
        self.require(0.0 <= self.min_condition < self.max_condition, "min_condition", expected)
        if self.ports is not None:
            is_omitted = self.min_condition == 0.0
            self.require(is_omitted, "min_condition", "left out where ports are given")

    @property
    def is_sampled(self) -> bool:
        """True if the start or the target is sampled."""
        return not (self.start and self.target)


@dataclass(frozen=True, eq=False)
class Scene:
    """Camera, tool, path and tissue of a simulated run.

    Parameters
    ----------
    optics : CameraModel
        Camera.
    body : ToolBody
        Tool.
    path : Floats
        Joints (n, 3) on the path from the start to the target.
    midpoint : Floats
        Joints (3,) at the path's midpoint.
    tissue : Tissue
        Tissue behind the tool.
    rejected : int
        Number of infeasible samples before this one.
    """

    optics: CameraModel

    body: ToolBody

    path: Floats

    midpoint: Floats

    tissue: Tissue

    rejected: int

    @property
    def start(self) -> Floats:
        """Joints (3,) of the start."""
        return self.path[0]

    @property
    def target(self) -> Floats:
        """Joints (3,) of the target."""
        return self.path[-1]
