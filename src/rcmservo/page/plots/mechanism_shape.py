"""The mechanism as the page draws it: points in the arm's base frame, whose origin is the RCM, in
mm.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.servo.servo import Servo

SURFACE_POINTS = 16
"""Points along a side of what the limits enclose."""


@dataclass(frozen=True)
class Shape:
    """What of a servo tells where its tool is.

    Parameters
    ----------
    mechanism : Kinematics
        The arm's joints.
    tool : Tool
        Its markers.
    tip : float
        mm from marker 2 to the tip.
    """

    mechanism: Kinematics
    tool: Tool
    tip: float

    @classmethod
    def of(cls, servo: Servo) -> "Shape":
        """That of a servo."""
        return cls(servo.mechanism, servo.tool, servo.controller.tip)

    def points(self, q: Floats) -> Floats:
        """Marker 1, marker 2 and the tip (3, 3) at the joints q (3,); NaN where they are not
        known.
        """
        p1 = self.mechanism.position(q)
        p1 = p1 * (1.0 + self.tool.offset / np.linalg.norm(p1))
        p2 = self.tool.second_marker(p1)
        return np.array([p1, p2, p2 + self.tip * p2 / np.linalg.norm(p2)])

    def limits(self) -> Floats:
        """The surface (STEPS, STEPS, 3) on which marker 1 is where the tool is inserted as far as
        it may be.
        """
        lower, upper = self.mechanism.limits.lower, self.mechanism.limits.upper
        one, two = (
            np.linspace(lower[joint], upper[joint], SURFACE_POINTS).tolist() for joint in (0, 1)
        )
        return np.array([[self.points(np.array([a, b, upper[2]]))[0] for b in two] for a in one])
