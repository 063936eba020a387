"""Assignment of an arm's joints to its motors and encoders, as its rig file describes it."""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, position_jacobian
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats

Order = tuple[int, int, int]
"""For each joint, the joint of the rig file whose axis drives it."""

ENCODER_STEPS = np.array([5e-5, 5e-5, 5e-3])
"""Resolution (rad, rad, mm) of an arm that reports no counts."""
MIN_LEVER_MM = 1.0
"""Least motion of marker 2 that a rad of an angle is supposed to make."""


@dataclass(frozen=True)
class Wiring:
    """Motors and encoders in a rig file. An arm that reports rad and mm has counts of 1 and -1.

    Parameters
    ----------
    counts : tuple[float, float, float]
        Counts per rad, rad and mm of the joints, negative where they fall as one rises.
    key : str
        Name of this setting in the section of the arm.
    axes : str
        Letters of the axes that drive the joints, `axes` in the section; empty if it has none.
    """

    counts: tuple[float, float, float]
    key: str = "counts"
    axes: str = ""

    @property
    def steps(self) -> Floats:
        """Resolution (3,) of the joints in rad, rad, mm."""
        return ENCODER_STEPS if self.signs_only else 1.0 / np.abs(self.counts)

    @property
    def signs_only(self) -> bool:
        """True if only the direction of a joint can be set."""
        return self.key != "counts"

    def line(self, factors: Floats) -> str:
        """Return the line with the counts of each joint times a factor (3,); empty if the section
        cannot express it.
        """
        if self.signs_only and (np.abs(factors) != 1.0).any():
            return ""
        values = (float(f"{c * f:.6g}") for c, f in zip(self.counts, factors, strict=True))
        return f"{self.key} = [{', '.join(map(repr, values))}]"

    def reordered(self, order: Order) -> str:
        """Return the letters of the axes in another order."""
        return "".join(self.axes[k] for k in order) if self.axes else ""


@dataclass(frozen=True)
class Robot:
    """The arm as a rig file describes it.

    Parameters
    ----------
    mechanism : Kinematics
        Its kinematics.
    tool : Tool
        Positions of the markers on the tool.
    wiring : Wiring
        Its motors and encoders.
    """

    mechanism: Kinematics
    tool: Tool
    wiring: Wiring

    def joint_per_mm(self, q: Floats) -> Floats:
        """Return the motion (3,) of each joint, rad or mm, that moves marker 2 by one mm at the
        joints q (3,).
        """
        reach = float(np.linalg.norm(self.tool.second_marker(self.first_marker(q)))) - q[2]
        jacobian = position_jacobian(self.mechanism.rcm()._replace(zero=reach), q)
        return 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), MIN_LEVER_MM)

    def first_marker(self, q: Floats) -> Floats:
        """Return marker 1 (3,) mm at the joints q (3,)."""
        return self.mechanism.position(q + np.array([0.0, 0.0, self.tool.offset]))

    def name(self, joint: int) -> str:
        """Return the number and the name of a joint."""
        return f"joint {joint + 1} ({self.mechanism.joint_names[joint]})"
