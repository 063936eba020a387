"""Checks of a target before a motion: within the image, markers apart, joints within their limits.

`Target` itself has finite pixels and arrays of the right shape. Whether the target is where its
joints say is known only during the motion: `rcmservo.safety.checks` compares both.
"""

import numpy as np

from rcmservo.errors import require
from rcmservo.geometry.kinematics import Kinematics
from rcmservo.interfaces import Floats
from rcmservo.safety.innovation import MAX_PIXEL_COORDINATE

MIN_MARKER_DISTANCE_PX = 2.0
"""Smallest distance of the markers in px: nearer, their direction is unknown at 1 px of noise."""


def require_possible_markers(field: str, points: Floats) -> None:
    """Raise `BadInput` for markers (2, 2) px outside any image, or too near each other."""
    limit = MAX_PIXEL_COORDINATE
    is_possible = bool((np.abs(points) < limit).all())
    require(is_possible, field, points.tolist(), f"pixels within ±{limit:.0f}")
    vector: Floats = points[1] - points[0]
    distance = float(np.linalg.norm(vector))
    expected = f"two markers at least {MIN_MARKER_DISTANCE_PX:g} px apart"
    require(distance >= MIN_MARKER_DISTANCE_PX, field, points.tolist(), expected)


def require_markers_in_image(field: str, points: Floats, width: int, height: int) -> None:
    """Raise `BadInput` for a marker (u, v) px outside the image of a camera."""
    is_in_image = (points >= -0.5) & (points <= np.array([width, height]) - 0.5)
    for i, marker in enumerate(points):
        expected = f"within the image of {width} x {height} px"
        require(bool(is_in_image[i].all()), f"{field}[{i}]", tuple(marker.tolist()), expected)


def require_joints_within_limits(
    field: str, q: Floats, mechanism: Kinematics, tolerance: float
) -> None:
    """Raise `BadInput` for a joint beyond its limit by more than `tolerance` times its range.

    Units are those of the joints q (3,): rad, rad, mm.
    """
    lower, upper = mechanism.limits.arrays
    slack = tolerance * (upper - lower)
    for i, name in enumerate(mechanism.joint_names):
        is_within = bool(lower[i] - slack[i] <= q[i] <= upper[i] + slack[i])
        expected = f"{name} within its limits {lower[i]:.6g} and {upper[i]:.6g}"
        require(is_within, f"{field}[{i}]", float(q[i]), expected)
