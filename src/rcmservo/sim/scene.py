"""A scene: where camera, start and target are, and what scenes are drawn from."""

from dataclasses import dataclass

import numpy as np

from rcmservo.errors import RcmServoError, require, require_radians
from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import FULL_TURN
from rcmservo.sim.body import Body
from rcmservo.sim.optics import Optics
from rcmservo.sim.rendering import Tissue

Triple = tuple[float, float, float]


class NoScene(RcmServoError):
    """No scene within the settings could be drawn."""


@dataclass(frozen=True)
class SceneSettings:
    """What scenes are drawn from. A pair of numbers is (least, greatest)."""

    focal: tuple[float, float] = (500.0, 900.0)
    """px, the camera's focal length."""

    distance: tuple[float, float] = (120.0, 300.0)
    """mm from the camera to the tool."""

    elevation: tuple[float, float] = (-0.2, 0.9)
    """rad of the camera above the tool, where down is the way from the RCM straight into the
    body."""

    ports: tuple[float, float] | None = None
    """mm between the tool's port, which is the RCM, and the camera's: the camera is an endoscope,
    ``distance`` from the tool and in the body. ``elevation`` and the conditions then count for
    nothing, as the RCM may be behind the camera. None: the camera is anywhere around the tool, and
    the RCM before it."""

    distortion: tuple[float, float] = (-0.08, 0.02)
    """k₁ and k₂ of the lens."""

    travel: tuple[float, float] = (20.0, 60.0)
    """mm from start to target."""

    insertion: tuple[float, float] = (70.0, 150.0)
    """mm of marker 1 from the RCM, at the start."""

    max_condition: float = 40.0
    """The scaled Jacobian's condition number is at most this on the straight way to the target."""

    min_condition: float = 0.0
    """Somewhere on that way it is more than this: 40 and a ``max_condition`` without bound make the
    hard scenes, which the default leaves out."""

    room: float = 10.0
    """mm about the start in which both markers stay in view, so that there is room to explore."""

    errors: Triple | None = None
    """rad, px, px: the start is where Δy = y − y_d is exactly this. The way is then that of the
    saturated law (33), and there is ``room`` half-way too."""

    start: Triple | None = None
    """rad, rad, mm: your own start instead of a drawn one. With a start and a target of your own,
    the scene need only show both markers."""

    target: Triple | None = None
    """rad, rad, mm: your own target instead of a drawn one."""

    def __post_init__(self) -> None:
        self._require("room", 0.0 <= self.room < np.inf, "a length in mm that is not negative")
        for name in ("focal", "distance", "travel", "insertion"):
            low, high = getattr(self, name)
            self._require(name, 0.0 < low <= high < np.inf, "two positive numbers, least first")
        low, high = self.ports or (1.0, 1.0)
        right = "two positive numbers, least first"
        self._require("ports", 0.0 < low <= high < np.inf, right)
        low, high = self.elevation
        self._require("elevation", -1.5 <= low <= high <= 1.5, "two angles from -1.5 to 1.5 rad")
        self._require("distortion", _finite(self.distortion), "two finite numbers k1, k2")
        wanted = self.errors is None or (_finite(self.errors) and any(self.errors))
        self._require("errors", wanted, "three finite numbers (rad, px, px), not all zero")
        alone = self.errors is None or (self.start is None and self.target is None)
        require_radians("scene.errors", self.errors, (self.errors or (0.0,))[:1], np.pi)
        self._require("errors", alone, "left out where start or target are given")
        seen = self.ports is None or self.errors is None
        self._require("errors", seen, "left out where ports are given, as they are about the RCM")
        self._require("max_condition", self.max_condition > 1.0, "a number above 1")
        hardest = self.max_condition
        easy = 0.0 <= self.min_condition < hardest
        self._require("min_condition", easy, f"a number from 0 to below max_condition = {hardest}")
        asked = self.ports is None or self.min_condition == 0.0
        self._require("min_condition", asked, "left out where ports are given")
        for name in ("start", "target"):
            q: Triple | None = getattr(self, name)
            self._require(name, q is None or _finite(q), "three finite joint values (rad, rad, mm)")
            require_radians(f"scene.{name}", q, (q or (0.0, 0.0))[:2], FULL_TURN)

    def _require(self, name: str, good: bool, right: str) -> None:
        require(good, f"scene.{name}", getattr(self, name), right)

    @property
    def free(self) -> bool:
        """Whether something of the way is drawn: not both its ends are your own."""
        return not (self.start and self.target)


def _finite(values: tuple[float, ...]) -> bool:
    return bool(np.all(np.isfinite(values)))


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
