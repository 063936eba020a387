"""A scene: where camera, start and target are, and what scenes are drawn from."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, Limit, Triple, angles, each, finite, not_negative
from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import FULL_TURN
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering import Tissue
from rcmservo.sim.tool_body import Body

Range = tuple[float, float]
LEAST_FIRST = Limit(
    lambda ends: 0.0 < ends[0] <= ends[1] < np.inf, "two positive numbers, least first"
)
ELEVATION = Limit(
    lambda ends: -1.5 <= ends[0] <= ends[1] <= 1.5, "two angles from -1.5 to 1.5 rad, least first"
)
ERRORS = Limit(
    lambda errors: bool(np.isfinite(errors).all()) and any(errors),
    "three finite numbers (rad, px, px), not all zero",
)
JOINTS = each(finite(), "three finite joint values (rad, rad, mm)")


class NoScene(RcmServoError):
    """No scene within the settings could be drawn."""


@dataclass(frozen=True)
class SceneSettings(Checked, section="scene"):
    """What scenes are drawn from. A pair of numbers is (least, greatest)."""

    focal: Annotated[Range, LEAST_FIRST] = (500.0, 900.0)
    """px, the camera's focal length."""

    distance: Annotated[Range, LEAST_FIRST] = (120.0, 300.0)
    """mm from the camera to the tool."""

    elevation: Annotated[Range, ELEVATION] = (-0.2, 0.9)
    """rad of the camera above the tool, where down is the way from the RCM straight into the
    body."""

    ports: Annotated[Range | None, LEAST_FIRST] = None
    """mm between the tool's port, which is the RCM, and the camera's: the camera is an endoscope,
    ``distance`` from the tool and in the body. ``elevation`` and the conditions then count for
    nothing, as the RCM may be behind the camera. None: the camera is anywhere around the tool, and
    the RCM before it."""

    distortion: Annotated[Range, each(finite(), "two finite numbers k1, k2")] = (-0.08, 0.02)
    """k₁ and k₂ of the lens."""

    travel: Annotated[Range, LEAST_FIRST] = (20.0, 60.0)
    """mm from start to target."""

    insertion: Annotated[Range, LEAST_FIRST] = (70.0, 150.0)
    """mm of marker 1 from the RCM, at the start."""

    max_condition: Annotated[float, Limit(lambda x: x > 1.0, "a number above 1")] = 40.0
    """The scaled Jacobian's condition number is at most this on the straight way to the target."""

    min_condition: float = 0.0
    """Somewhere on that way it is more than this: 40 and a ``max_condition`` without bound make the
    hard scenes, which the default leaves out."""

    room: Annotated[float, not_negative("length in mm")] = 10.0
    """mm about the start in which both markers stay in view, so that there is room to explore."""

    errors: Annotated[Triple | None, ERRORS, angles(np.pi, first=1)] = None
    """rad, px, px: the start is where Δy = y − y_d is exactly this. The way is then that of the
    saturated law (33), and there is ``room`` half-way too."""

    start: Annotated[Triple | None, JOINTS, angles(FULL_TURN, first=2)] = None
    """rad, rad, mm: your own start instead of a drawn one. With a start and a target of your own,
    the scene need only show both markers."""

    target: Annotated[Triple | None, JOINTS, angles(FULL_TURN, first=2)] = None
    """rad, rad, mm: your own target instead of a drawn one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        alone = self.errors is None or (self.start is None and self.target is None)
        self.require(alone, "errors", "left out where start or target are given")
        seen = self.ports is None or self.errors is None
        self.require(seen, "errors", "left out where ports are given, as they are about the RCM")
        easy = f"a number from 0 to below max_condition = {self.max_condition}"
        self.require(0.0 <= self.min_condition < self.max_condition, "min_condition", easy)
        asked = self.ports is None or self.min_condition == 0.0
        self.require(asked, "min_condition", "left out where ports are given")

    @property
    def free(self) -> bool:
        """Whether something of the way is drawn: not both its ends are your own."""
        return not (self.start and self.target)


@dataclass(frozen=True, eq=False)
class Scene:
    """A drawn scene."""

    optics: Optics
    """The true camera."""

    body: Body
    """The tool."""

    way: Floats
    """(n, 3) joints from the start to the target."""

    half_way: Floats
    """(3,) joints."""

    tissue: Tissue
    """What is behind the tool."""

    rejected: int
    """Draws that did not suit before this one did."""

    @property
    def start(self) -> Floats:
        return self.way[0]

    @property
    def target(self) -> Floats:
        return self.way[-1]
