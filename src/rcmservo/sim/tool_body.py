"""The tool's body in space: what the cameras see of it."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import put
from rcmservo.method.kinematics import Kinematics, Rcm, axis, position
from rcmservo.method.tool import Shaft, Tool, second_marker

TIP = 14.0
"""mm by which the instrument's tip stands out beyond marker 2."""


@compiled
def places(rcm: Rcm, shaft: Shaft, q: Floats) -> Floats:
    """`Body.points`; the mechanism's point is marker 1."""
    out, n = np.zeros((4, 3)), axis(rcm, q)
    put(out[0], position(rcm, q))
    put(out[1], second_marker(shaft, out[0]))
    for k in range(3):
        out[3, k] = out[1, k] + TIP * n[k]
    return out


class Body:
    """Where the joints put the tool's markers, its tip, and its shaft up to the RCM."""

    def __init__(self, mechanism: Kinematics, tool: Tool) -> None:
        self.mechanism, self.tool = mechanism, tool
        self.rcm = mechanism.rcm(tool.offset)

    def points(self, q: Floats) -> Floats:
        """m₁, m₂, the shaft's start at the RCM and the tip, (4, 3) mm, at the joints q (3,)."""
        return places(self.rcm, self.tool.shaft, np.ascontiguousarray(q, dtype=float))
