"""Check of recorded joints against the rig's limits, with a hint if they are in another unit.

A value that no arm can reach was probably recorded in degrees or mm.
"""

import numpy as np

from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import FULL_TURN_RAD, MAX_TRAVEL_MM, JointLimits
from rcmservo.interfaces import Floats
from rcmservo.recording.foreign.pose_table import Table

TO_RECORDED_UNITS = np.array([1.0, 1.0, 1e-3])
"""Factors from rad, rad, mm to the units of a recording: rad, rad, m."""

RECORDED_UNITS = ("rad", "rad", "m")
"""Units of the joints in a recording."""

CONFUSED_UNITS = ("degrees", "degrees", "mm")
"""Units in which joints are often recorded by mistake."""

MAX_JOINT_VALUES = (FULL_TURN_RAD, FULL_TURN_RAD, MAX_TRAVEL_MM)
"""Largest joint values of any arm, in rad, rad, mm."""

LIMIT_TOLERANCES = (0.01, 0.01, 1.0)
"""Largest distance of a joint beyond its limit, which a real arm may have, in rad, rad, mm."""


def read_joints(table: Table, columns: tuple[str, ...], limits: JointLimits) -> Floats:
    """Return the joints (n, 3) of all rows in rad, rad, mm.

    Raises
    ------
    BadInput
        If a joint is outside the limits; the message names the likely unit.
    """
    q = np.array([row.numbers(columns) for row in table.rows]).reshape(-1, 3) / TO_RECORDED_UNITS
    lower, upper = limits.arrays
    for i, column in enumerate(columns):
        low, high = lower[i] - LIMIT_TOLERANCES[i], upper[i] + LIMIT_TOLERANCES[i]
        is_outside = (q[:, i] < low) | (q[:, i] > high)
        if is_outside.any():
            first_row = int(np.argmax(is_outside))
            recorded_value = float(f"{q[first_row, i] * TO_RECORDED_UNITS[i]:.9g}")
            name = f"{table.rows[first_row].location}: {column}"
            raise BadInput(name, recorded_value, _describe_range(q, limits, i))
    return q


def _describe_range(q: Floats, limits: JointLimits, i: int) -> str:
    """Return the range of joint i, and the unit that its column seems to have."""
    low, high = limits.lower[i] * TO_RECORDED_UNITS[i], limits.upper[i] * TO_RECORDED_UNITS[i]
    is_implausible = np.abs(q[:, i]).max() > MAX_JOINT_VALUES[i]
    hint = f" (this looks like {CONFUSED_UNITS[i]})" if is_implausible else ""
    return f"within the rig's limits, {low:.4g} to {high:.4g} {RECORDED_UNITS[i]}{hint}"
