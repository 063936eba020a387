"""Tool as points in space: its two markers, the start of its shaft and its tip."""

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, RcmStruct, compute_axis_tuple
from rcmservo.geometry.tool import Tool, ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.sim.imperfect_markers import (
    NO_IMPERFECTIONS,
    ImperfectionsStruct,
    move_across,
    place_marker,
)

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
    imperfections : ImperfectionsStruct
        Errors of axes, markers, shaft and port; none by default.
    """

    def __init__(
        self,
        mechanism: Kinematics,
        tool: Tool,
        imperfections: ImperfectionsStruct = NO_IMPERFECTIONS,
    ) -> None:
        self.mechanism, self.tool, self.imperfections = mechanism, tool, imperfections
        self.rcm = mechanism.to_struct(tool.offset)

    def points(self, q: Floats, q_before: Floats | None = None, time: int = 0) -> Floats:
        """Return the positions of the tool's points at the joints q (3,).

        Parameters
        ----------
        q : Floats, shape (3,)
            Joints at `time`.
        q_before : Floats, shape (3,), optional
            Joints BEND_INTERVAL_NS earlier, whose difference bends the shaft; by default the tool
            rests.
        time : int
            Time (ns) for the motion of the port.

        Returns
        -------
        Floats, shape (4, 3)
            Marker 1, marker 2, the shaft's start at the RCM, and the tip, mm from the RCM.
        """
        joints = np.ascontiguousarray(q, dtype=float)
        before = joints if q_before is None else np.ascontiguousarray(q_before, dtype=float)
        errors, shaft = self.imperfections.rows[0], self.tool.struct
        return compute_body_points(errors, self.rcm, shaft, joints, before, time)


@compiled
def compute_body_points(
    errors: ImperfectionsStruct,
    rcm: RcmStruct,
    tool: ToolStruct,
    q: Floats,
    q_before: Floats,
    time: int,
) -> Floats:
    """Return `ToolBody.points`, (4, 3) mm; the reference point of `rcm` is marker 1."""
    points, (x, y, z) = np.zeros((4, 3)), compute_axis_tuple(rcm, q)
    for k in range(2):
        points[k, 0], points[k, 1], points[k, 2] = place_marker(
            errors, rcm, tool, q, q_before, time, k
        )
    if errors.is_any:
        start = move_across(errors, rcm, q, (0.0, 0.0, 0.0), errors.shaft_offset, 0.0)
        points[2, 0], points[2, 1], points[2, 2] = start
    for i, direction in enumerate((x, y, z)):
        points[3, i] = points[1, i] + TIP_BEYOND_MARKER_2_MM * direction
    return points
