"""Assignment of an arm's joints to its motors and encoders, as the rig file describes it.

An axis is a motor with its encoder, as the arm's controller names it. `Robot` joins the wiring with
the kinematics and the tool.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.geometry.kinematics import Kinematics, compute_position_jacobian
from rcmservo.geometry.tool import Tool
from rcmservo.interfaces import Floats

Order = tuple[int, int, int]
"""Index of the axis in the rig file that drives joint 1, 2 and 3."""

DEFAULT_STEPS = np.array([5e-5, 5e-5, 5e-3])
"""Assumed resolution (rad, rad, mm) of an arm that reports no encoder counts."""
MIN_LEVER_MM = 1.0
"""Lower bound (mm per rad, or mm per mm) on the motion of marker 2 per unit of a joint's motion."""


@dataclass(frozen=True)
class Wiring:
    """Motors and encoders of an arm, as its rig file describes them.

    An arm that reports rad and mm instead of encoder counts has counts of 1 or -1. A user-defined
    arm has counts of 1 and an empty `key`, because the rig file has no key for them.

    Parameters
    ----------
    counts : tuple[float, float, float]
        Encoder counts per rad, rad and mm of joints 1 to 3; negative if the count falls while the
        joint rises.
    key : str
        Key of `counts` in the rig file's section [arm]; empty if it has none.
    axes : str
        Letters of the axes that drive joints 1 to 3, key `axes` of [arm]; empty if the arm has no
        such key.
    """

    counts: tuple[float, float, float]
    key: str = "counts"
    axes: str = ""

    @property
    def steps(self) -> Floats:
        """Resolution (3,) of the joints in rad, rad, mm."""
        return DEFAULT_STEPS if self.has_signs_only else 1.0 / np.abs(self.counts)

    @property
    def has_signs_only(self) -> bool:
        """True if the rig file sets at most the direction of each joint, not its scale."""
        return self.key != "counts"

    def format_corrected_line(self, factors: Floats) -> str:
        """Return the line of the rig file that scales the counts by `factors` (3,).

        The line is empty if [arm] has no such key, or holds signs only and a factor is not 1 or -1.
        """
        if not self.key or (self.has_signs_only and (np.abs(factors) != 1.0).any()):
            return ""
        values = [float(f"{count:.6g}") for count in np.array(self.counts) * factors]
        return f"{self.key} = {values}"

    def reorder_axes(self, order: Order) -> str:
        """Return the letters of the axes, permuted by `order`; empty if the arm has no letters."""
        return "".join(self.axes[k] for k in order) if self.axes else ""


@dataclass(frozen=True)
class Robot:
    """Arm and tool as a rig file describes them.

    Parameters
    ----------
    mechanism : Kinematics
        Kinematics of the arm.
    tool : Tool
        Positions of the markers on the tool.
    wiring : Wiring
        Motors and encoders of the arm.
    """

    mechanism: Kinematics
    tool: Tool
    wiring: Wiring

    def compute_joint_per_mm(self, q: Floats) -> Floats:
        """Return the motions (3,) in rad, rad, mm that move marker 2 by 1 mm from the joints `q`.

        Each joint moves alone, from the joint positions `q` (3,) in rad, rad, mm.
        """
        marker_2 = self.tool.second_marker(self.compute_first_marker(q))
        zero = float(np.linalg.norm(marker_2)) - q[2]  # moves the end of the mechanism to marker 2
        jacobian = compute_position_jacobian(self.mechanism.to_struct()._replace(zero=zero), q)
        return 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), MIN_LEVER_MM)

    def compute_first_marker(self, q: Floats) -> Floats:
        """Return the position (3,) of marker 1 in mm at the joints `q` (3,)."""
        return self.mechanism.position(q + np.array([0.0, 0.0, self.tool.offset]))

    def describe_joint(self, joint: int) -> str:
        """Return the number of a joint, counted from 1, with its name."""
        return f"joint {joint + 1} ({self.mechanism.joint_names[joint]})"
