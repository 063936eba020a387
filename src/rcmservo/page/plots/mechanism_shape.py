"""Points of arm and tool for the 3-D plot, in mm in the arm's base frame (origin at the RCM)."""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import Kinematics
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats
from rcmservo.servo.servo import Servo

SURFACE_GRID_SIZE = 16
"""Number of grid points along each side of the workspace surface."""


@dataclass(frozen=True)
class MechanismShape:
    """Geometry from which the points of the 3-D plot follow.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics and joint limits of the arm.
    tool : Tool
        Positions of the markers on the tool.
    tip_distance : float
        Distance from marker 2 to the tip along the tool's axis, mm.
    """

    mechanism: Kinematics
    tool: Tool
    tip_distance: float

    @classmethod
    def from_servo(cls, servo: Servo) -> "MechanismShape":
        """Return the geometry in a servo's settings."""
        return cls(servo.mechanism, servo.tool, servo.controller.tip)

    def compute_points(self, q: Floats) -> Floats:
        """Return the positions of marker 1, marker 2 and tip.

        Parameters
        ----------
        q : array (3,)
            Joints in rad, rad, mm; NaN if unknown.

        Returns
        -------
        Floats
            Positions (3, 3) in mm, one row per point; NaN if the joints are.
        """
        reference = self.mechanism.position(q)
        p1 = reference * (1.0 + self.tool.offset / np.linalg.norm(reference))
        p2 = self.tool.second_marker(p1)
        tip = p2 + self.tip_distance * p2 / np.linalg.norm(p2)
        return np.array([p1, p2, tip])

    def compute_workspace_surface(self) -> Floats:
        """Return the positions of marker 1 at full insertion, on a grid over both angles.

        Returns
        -------
        Floats
            Positions (SURFACE_GRID_SIZE, SURFACE_GRID_SIZE, 3) in mm: q₁ varies along the first
            index and q₂ along the second, both from limit to limit.
        """
        lower, upper = self.mechanism.limits.lower, self.mechanism.limits.upper
        values_1, values_2 = (
            np.linspace(lower[joint], upper[joint], SURFACE_GRID_SIZE).tolist() for joint in (0, 1)
        )
        configurations = [[np.array([q1, q2, upper[2]]) for q2 in values_2] for q1 in values_1]
        return np.array([[self.compute_points(q)[0] for q in row] for row in configurations])
