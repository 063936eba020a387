"""Tool as points in space: its two markers, the start of its shaft and its tip."""

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, RcmStruct, compute_axis, compute_position
from rcmservo.geometry.tool import Tool, ToolStruct, compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into

TIP_BEYOND_MARKER_2_MM = 14.0
"""Distance (mm) from marker 2 to the instrument's tip."""


class ToolBody:
    """Tool on an arm.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics of the arm.
    tool : Tool
        Positions of the markers on the tool.
    """

    def __init__(self, mechanism: Kinematics, tool: Tool) -> None:
        self.mechanism, self.tool = mechanism, tool
        self.rcm = mechanism.to_struct(tool.offset)

    def points(self, q: Floats) -> Floats:
        """Return the positions of the tool's points at the joints q (3,).

        Returns
        -------
        Floats, shape (4, 3)
            Marker 1, marker 2, the shaft's start at the RCM, and the tip, mm from the RCM.
        """
        return compute_body_points(self.rcm, self.tool.struct, np.ascontiguousarray(q, dtype=float))


@compiled
def compute_body_points(rcm: RcmStruct, tool: ToolStruct, q: Floats) -> Floats:
    """Return `ToolBody.points`, (4, 3) mm; the reference point of `rcm` is marker 1."""
    points, axis = np.zeros((4, 3)), compute_axis(rcm, q)
    copy_into(points[0], compute_position(rcm, q))
    copy_into(points[1], compute_second_marker(tool, points[0]))
    for k in range(3):
        points[3, k] = points[1, k] + TIP_BEYOND_MARKER_2_MM * axis[k]
    return points
