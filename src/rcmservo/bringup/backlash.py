"""Backlash of a joint, by approaching a position from both sides, and repeatability of a pose.

The encoders at the motors do not show backlash, but the markers do. If S (px per rad or mm) is the
motion of the markers per joint motion, the markers at one position of the joint differ by d = S b
between an approach from above and one from below, so that the backlash is b = Sᵀd / SᵀS. A second
approach from above shows how well a pose is repeated.
"""

from dataclasses import dataclass

import numpy as np

from rcmservo.bringup.motion import Mover
from rcmservo.bringup.observations import PixelBound, StillView
from rcmservo.interfaces import Floats

MIN_SIGMAS = 4.0
"""Backlash in standard deviations from which it counts as measured."""


@dataclass(frozen=True)
class Backlash:
    """Backlash of one joint.

    Parameters
    ----------
    joint : int
        Index of the joint.
    size : float
        Lost motion when the joint turns back, rad or mm.
    deviation : float
        Standard deviation of `size` by the noise of the markers, rad or mm.
    repeatability : float
        Difference between two approaches to a pose from the same side (rms), rad or mm.
    """

    joint: int
    size: float
    deviation: float
    repeatability: float

    @property
    def is_measured(self) -> bool:
        """True if noise does not explain it."""
        return self.size > MIN_SIGMAS * self.deviation


def measure_backlash(mover: Mover, joint: int, motion: float, bound: PixelBound) -> Backlash:
    """Move a joint by `motion` (rad or mm) up, down and up again, each time and back.

    Return the backlash by the markers at rest at both ends of each motion.
    """
    up, from_above = visit_there_and_back(mover, joint, motion, bound)
    down, from_below = visit_there_and_back(mover, joint, -motion, bound)
    up_again, from_above_again = visit_there_and_back(mover, joint, motion, bound)
    # both views of a difference are approached from the same side
    rises = compute_difference(up, from_below, joint), compute_difference(from_above, down, joint)
    S = 0.5 * sum(points / q for q, points in rises)
    sizes = [convert(*compute_difference(from_above, from_below, joint), S)]
    sizes.append(convert(*compute_difference(from_above_again, from_below, joint), S))
    pairs = (up_again, up), (from_above_again, from_above)
    repeats = [convert(*compute_difference(*pair, joint), S) for pair in pairs]
    deviation = np.sqrt(1.5) * from_below.mean_noise / np.linalg.norm(S)
    repeatability = float(np.sqrt(np.mean(np.square(repeats))))
    return Backlash(joint, float(np.mean(sizes)), float(deviation), repeatability)


def visit_there_and_back(
    mover: Mover, joint: int, motion: float, bound: PixelBound
) -> tuple[StillView, StillView]:
    """Return the views at a motion of the joint from its position, and there again."""
    views = mover.visit(joint, (motion,), bound)
    return views[0], views[-1]


def compute_difference(view: StillView, other: StillView, joint: int) -> tuple[float, Floats]:
    """Return by how much the joint and the markers (2, 2) px differ between two views."""
    return float(view.q[joint] - other.q[joint]), view.points - other.points


def convert(q: float, points: Floats, S: Floats) -> float:
    """Return the motion of the joint that its encoder does not show, rad or mm.

    The encoder shows q rad or mm, and the markers move by `points` (2, 2) px.
    """
    return float(np.sum(S * (points - S * q)) / np.sum(S * S))
