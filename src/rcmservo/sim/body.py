"""The tool's body in space: what the cameras see of it."""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import Kinematics
from rcmservo.method.tool import Tool

TIP = 14.0
"""mm by which the instrument's tip stands out beyond marker 2."""


class Body:
    """Where the joints put the tool's markers, its tip, and its shaft up to the RCM."""

    def __init__(self, mechanism: Kinematics, tool: Tool) -> None:
        self.mechanism, self.tool = mechanism, tool

    def points(self, q: Floats) -> Floats:
        """m₁, m₂, the shaft's start at the RCM and the tip, (4, 3) mm, at the joints q (3,)."""
        reference = self.mechanism.position(q)
        n = reference / np.linalg.norm(reference)
        p1 = reference + self.tool.offset * n
        p2 = self.tool.second_marker(p1)
        return np.stack([p1, p2, np.zeros(3), p2 + TIP * n])
