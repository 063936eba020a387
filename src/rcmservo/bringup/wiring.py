"""How an arm's joints hang on its motors, in the words of its section of a rig file; and what was
found wrong with a line of it."""

from dataclasses import dataclass

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import Kinematics, position_jacobian
from rcmservo.method.tool import Tool

Order = tuple[int, int, int]
"""For each joint of three, another one."""


TOLD_APART = np.array([5e-5, 5e-5, 5e-3])
"""rad, rad, mm."""


@dataclass(frozen=True)
class Finding:
    """Something that is not as the rig file says, or as it must be."""

    what: str
    """In a few words."""
    where: str
    """The setting, such as arm.counts[1], or the device."""
    found: str
    """What was seen."""
    expected: str
    """What it would have to be."""
    line: str = ""
    """The line of the rig file that makes it right; empty where none does."""


@dataclass(frozen=True)
class Wiring:
    """What a rig file says of motors and encoders. An arm that tells its joints in their own units
    has counts of 1 and -1."""

    counts: tuple[float, float, float]
    """Counts of a rad, rad and mm of the joints, negative where they fall as one rises."""
    key: str = "counts"
    """What its section calls them."""
    axes: str = ""
    """The letters of the axes that drive the joints, `axes` in its section; empty where it has
    none."""

    @property
    def steps(self) -> Floats:
        """rad, rad, mm (3,) by which the joints can be told apart: counts, or where the arm counts
        itself, about what encoders have."""
        return TOLD_APART if self.signs_only else 1.0 / np.abs(self.counts)

    @property
    def signs_only(self) -> bool:
        """Whether nothing but which way a joint counts can be set."""
        return self.key != "counts"

    def line(self, factors: Floats) -> str:
        """The line with each joint's counts times a factor (3,); empty where none can say that."""
        if self.signs_only and (np.abs(factors) != 1.0).any():
            return ""
        values = (float(f"{c * f:.6g}") for c, f in zip(self.counts, factors, strict=True))
        return f"{self.key} = [{', '.join(map(repr, values))}]"

    def reordered(self, order: Order) -> str:
        """The letters, each joint having that of the joint in its place."""
        return "".join(self.axes[k] for k in order)


@dataclass(frozen=True)
class Robot:
    """What a rig file says of the robot."""

    mechanism: Kinematics
    """Its kinematics."""
    tool: Tool
    """Where the markers are on the tool."""
    wiring: Wiring
    """How it hangs on its motors."""

    def way(self, q: Floats, joint: int) -> float:
        """rad or mm of a joint that bring marker 2 on by one mm at the joints q (3,)."""
        reach = float(np.linalg.norm(self.tool.second_marker(self.first(q)))) - q[2]
        rcm = self.mechanism.rcm()._replace(zero=reach)
        return 1.0 / max(float(np.linalg.norm(position_jacobian(rcm, q)[:, joint])), LEAST_LEVER)

    def first(self, q: Floats) -> Floats:
        """Marker 1 (3,) mm at the joints q (3,)."""
        return self.mechanism.position(q + np.array([0.0, 0.0, self.tool.offset]))


LEAST_LEVER = 1.0
"""mm by which a rad of an angle is taken to bring marker 2 on at least."""
