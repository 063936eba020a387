"""Positions in space of the tool's markers, shaft and tip."""

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, RcmStruct, compute_axis, compute_position
from rcmservo.geometry.tool import Tool, ToolStruct, compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into

TIP_BEYOND_MARKER_2_MM = 14.0
"""Distance (mm) from marker 2 to the instrument's tip."""


@compiled
def compute_body_points(rcm: RcmStruct, shaft: ToolStruct, q: Floats) -> Floats:
    """Compute `ToolBody.points`; `rcm`'s reference point is marker 1."""
    out, n = np.zeros((4, 3)), compute_axis(rcm, q)
    copy_into(out[0], compute_position(rcm, q))
    copy_into(out[1], compute_second_marker(shaft, out[0]))
    for k in range(3):
        out[3, k] = out[1, k] + TIP_BEYOND_MARKER_2_MM * n[k]
    return out


class ToolBody:
    """Tool as points in space.

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
        """Return marker 1, marker 2, the shaft's start at the RCM and the tip at the joints q (3,).

        Returns
        -------
        Floats, shape (4, 3)
            Positions in the world, mm.
        """
        return compute_body_points(self.rcm, self.tool.struct, np.ascontiguousarray(q, dtype=float))
