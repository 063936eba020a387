"""Direction from which each joint reaches the position of a view.

An encoder at the motor does not show the backlash b of its joint. A motion larger than b takes up
the backlash: the tool then follows the motor upwards, or stays b above it downwards. Smaller
motions leave the position of the tool in the backlash unknown.
"""

from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from rcmservo.bringup.backlash import MIN_SIGMAS
from rcmservo.bringup.observations import JointMotion
from rcmservo.interfaces import Floats

MIN_MOTION_RATIO = 1.3
"""Smallest ratio of a motion to the backlash that it takes up."""


def find_directions(motions: Sequence[JointMotion]) -> Floats:
    """Return 1 for each joint (n, 3) that has come from above, 0 for the others.

    The first of the n views is the one before all motions.
    """
    descended = [np.zeros(3)]
    for motion in motions:
        for k in range(len(motion.views)):
            latest = descended[-1].copy()
            latest[motion.joint] = k % 2
            descended.append(latest)
    return np.array(descended)


def find_known_views(motions: Sequence[JointMotion]) -> int | None:
    """Return the index of the first view whose joints of the tool are known.

    It is the first one after every joint has taken up its backlash, None until all joints have
    moved since then.
    """
    first = find_taken_up(motions)
    if first is None:
        return None
    ends = compute_ends(motions)
    moved = {motion.joint for motion, end in zip(motions, ends, strict=True) if end > first}
    return first if len(moved) == 3 else None


def find_taken_up(motions: Sequence[JointMotion]) -> int | None:
    """Return the index of the first view after every joint has taken up its backlash.

    It counts the view before all motions, and is 0 if no joint has measurable backlash. It is None
    if the motions of a joint are too small yet.
    """
    ends, first = compute_ends(motions), 0
    for joint in range(3):
        own = [k for k, motion in enumerate(motions) if motion.joint == joint]
        backlash = estimate_backlash([motions[k] for k in own])
        large = [ends[k] for k in own if motions[k].size > MIN_MOTION_RATIO * backlash]
        if not large:
            return None
        first = max(first, large[0]) if backlash > 0.0 else first
    return first


def compute_ends(motions: Sequence[JointMotion]) -> list[int]:
    """Return the index of the last view of each motion, counting the view before all motions."""
    return list(accumulate(len(motion.views) for motion in motions))


def estimate_backlash(motions: Sequence[JointMotion]) -> float:
    """Return the backlash (rad or mm) of a joint by its last motion in both directions.

    If S (px per rad or mm) is the motion of the markers on the way up, and d is by how much they
    move less on the way down, the backlash is Sᵀd / SᵀS. It is 0 if noise explains it, and at most
    about the size of the motion, which a larger backlash swallows. The curvature of the projection
    adds to it, so that it is only an estimate.
    """
    complete = [motion for motion in motions if len(motion.views) == 3]
    if not complete:
        return 0.0
    joint, (above, below, home) = complete[-1].joint, complete[-1].views
    rise, fall = (float(view.q[joint] - home.q[joint]) for view in (above, below))
    if not rise > 0.0 or np.array_equal(above.points, home.points):
        return 0.0
    S = (above.points - home.points) / rise
    d = below.points - home.points - S * fall
    deviation = np.sqrt(6.0) * home.mean_noise / float(np.linalg.norm(S))
    size = float(np.sum(S * d) / np.sum(S * S))
    return size if size > MIN_SIGMAS * deviation else 0.0
