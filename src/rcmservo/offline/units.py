"""Joints of a recording, each within the rig's limits: what is far beyond was recorded in another
unit."""

import numpy as np

from rcmservo.errors import BadInput
from rcmservo.interfaces import Floats
from rcmservo.method.kinematics import FULL_TURN, LONGEST_TRAVEL, JointLimits
from rcmservo.offline.table import Table

METRES = np.array([1.0, 1.0, 1e-3])
"""Joints in rad, rad, mm times this are those of a recording, in rad, rad, m."""

UNITS = ("rad", "rad", "m")
MISTAKEN = ("degrees", "degrees", "mm")
"""The units in which joints are recorded by mistake."""

POSSIBLE = (FULL_TURN, FULL_TURN, LONGEST_TRAVEL)
"""What no joint of any arm is beyond, in rad, rad, mm."""

SLACK = (0.01, 0.01, 1.0)
"""rad, rad, mm by which a real arm may stand beyond its limits."""


def joints(table: Table, columns: tuple[str, ...], limits: JointLimits) -> Floats:
    """The joints (n, 3) rad, rad, mm of all rows."""
    q = np.array([row.numbers(columns) for row in table.rows]).reshape(-1, 3) / METRES
    lower, upper = limits.arrays
    for i, column in enumerate(columns):
        beyond = (q[:, i] < lower[i] - SLACK[i]) | (q[:, i] > upper[i] + SLACK[i])
        if beyond.any():
            first = int(np.argmax(beyond))
            value = float(f"{q[first, i] * METRES[i]:.9g}")
            raise BadInput(f"{table.rows[first].place}: {column}", value, _right(q, limits, i))
    return q


def _right(q: Floats, limits: JointLimits, i: int) -> str:
    """What joint i should be, and in which unit its column seems to be."""
    low, high = limits.lower[i] * METRES[i], limits.upper[i] * METRES[i]
    far = np.abs(q[:, i]).max() > POSSIBLE[i]
    hint = f" (this looks like {MISTAKEN[i]})" if far else ""
    return f"within the rig's limits, {low:.4g} to {high:.4g} {UNITS[i]}{hint}"
