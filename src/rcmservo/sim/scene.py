"""Scenes: camera, start and target, and the distributions from which they are sampled."""

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
    """No scene within the settings was found."""


@dataclass(frozen=True)
class SceneSettings(Checked, section="scene"):
    """Distributions from which scenes are sampled. A pair of numbers is (least, greatest).

    Parameters
    ----------
    focal : Range
        Focal length of the camera, px.
    distance : Range
        Distance from the camera to the tool, mm.
    elevation : Range
        Elevation (rad) of the camera above the tool; down is the direction from the RCM straight
        into the body.
    ports : Range or None
        Distance (mm) from the tool's port, which is the RCM, to the port of an endoscope. The
        camera is then inside the body, ``distance`` from the tool; ``elevation`` and the limits of
        the condition number have no effect, because the RCM may be behind the camera. None: the
        camera is anywhere around the tool, with the RCM in front of it.
    distortion : Range
        Radial distortion k₁ and k₂ of the lens.
    travel : Range
        Distance from start to target, mm.
    insertion : Range
        Distance (mm) of marker 1 from the RCM at the start.
    max_condition : float
        Largest condition number of the scaled Jacobian on the straight path to the target.
    min_condition : float
        The condition number exceeds this somewhere on that path. 40 with an unlimited
        ``max_condition`` gives the hard scenes that the default excludes.
    room : float
        Distance (mm) that both markers can move from the start without leaving the image: room to
        explore.
    errors : Triple or None
        Initial error Δy = y − y_d (rad, px, px). The path is then that of the saturated law (33),
        and ``room`` holds at its midpoint too.
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
        without_joints = self.errors is None or (self.start is None and self.target is None)
        self.require(without_joints, "errors", "left out where start or target is given")
        without_ports = self.ports is None or self.errors is None
        self.require(
            without_ports, "errors", "left out where ports are given: the RCM may be unseen"
        )
        below_max = f"a number from 0 to below max_condition = {self.max_condition}"
        self.require(0.0 <= self.min_condition < self.max_condition, "min_condition", below_max)
        unlimited = self.ports is None or self.min_condition == 0.0
        self.require(unlimited, "min_condition", "left out where ports are given")

    @property
    def is_sampled(self) -> bool:
        """True if the start or the target is sampled."""
        return not (self.start and self.target)


@dataclass(frozen=True, eq=False)
class Scene:
    """Sampled scene.

    Parameters
    ----------
    optics : CameraModel
        True camera.
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
        return self.path[0]

    @property
    def target(self) -> Floats:
        return self.path[-1]
