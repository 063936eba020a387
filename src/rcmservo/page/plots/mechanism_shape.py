"""Points of the mechanism for the 3-D scene, in mm in the arm's base frame (origin at the RCM)."""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.servo.servo import Servo

SURFACE_POINTS = 16
"""Number of points along each side of the workspace surface."""


@dataclass(frozen=True)
class MechanismShape:
    """Kinematics of arm and tool, for drawing.

    Parameters
    ----------
    mechanism : Kinematics
        Joints of the arm.
    tool : Tool
        Markers of the tool.
    tip : float
        Distance from marker 2 to the tip in mm.
    """

    mechanism: Kinematics
    tool: Tool
    tip: float

    @classmethod
    def of(cls, servo: Servo) -> "MechanismShape":
        """Return the shape of a servo."""
        return cls(servo.mechanism, servo.tool, servo.controller.tip)

    def compute_points(self, q: Floats) -> Floats:
        """Return marker 1, marker 2 and tip (3, 3) in mm at joints q (3,); NaN if unknown."""
        p1 = self.mechanism.position(q)
        p1 = p1 * (1.0 + self.tool.offset / np.linalg.norm(p1))
        p2 = self.tool.second_marker(p1)
        return np.array([p1, p2, p2 + self.tip * p2 / np.linalg.norm(p2)])

    def compute_workspace_surface(self) -> Floats:
        """Return the points that marker 1 reaches at full insertion.

        Returns
        -------
        Floats
            Points (SURFACE_POINTS, SURFACE_POINTS, 3) in mm.
        """
        lower, upper = self.mechanism.limits.lower, self.mechanism.limits.upper
        q1, q2 = (np.linspace(lower[j], upper[j], SURFACE_POINTS).tolist() for j in (0, 1))
        joints = [[np.array([a, b, upper[2]]) for b in q2] for a in q1]
        return np.array([[self.compute_points(q)[0] for q in row] for row in joints])
