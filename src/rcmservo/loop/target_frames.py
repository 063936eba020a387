"""Frames of a tool at rest from which a target is taught, and the check that they agree."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.constraints import between
from rcmservo.interfaces import Floats, Observation, Target

TEACHING_FRAMES = 300
"""Default number of frames that a target is the mean of: 5 s at 60 frames per second. At 1 px of
noise 98 % of runs then end within 1 mm, and 87 % with 30 frames; see docs/how_to_choose.md."""

MAX_FRAMES = 100_000
"""Largest number of frames that a target may be the mean of."""

MAD_TO_STD = 1.4826
"""Ratio of the standard deviation of Gaussian noise to its median absolute deviation."""

MAX_NOISE_PX = 2.0
"""Standard deviation in px above which a marker counts as unsteady: no sound tracker has it."""

NOISE_FLOOR_PX = 0.7
"""Smallest standard deviation in px for the outlier test, as few frames estimate it badly."""

OUTLIER_SIGMAS = 6.0
"""Distance from the median, in standard deviations, beyond which a marker is an outlier."""

MAX_OUTLIER_FRACTION = 0.05
"""Largest fraction of outliers among the frames."""


FRAMES = between(1, MAX_FRAMES, "a whole number", "frames")
"""Limit of the number of frames that a target is the mean of."""


def require_frames(frames: int, name: str = "frames") -> None:
    """Raise ``BadInput`` if a target cannot be the mean of this number of frames."""
    FRAMES.require(name, frames)


def mean_known(rows: Floats) -> Floats:
    """Return the mean of the finite entries of each column of (n, k); NaN if there are none."""
    known = np.isfinite(rows)
    total, count = np.where(known, rows, 0.0).sum(axis=0), known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass
class TargetFrames:
    """Frames whose mean becomes a target.

    Parameters
    ----------
    points : list[Floats]
        Markers (2, 2) in px of each frame.
    sizes : list[Floats]
        Apparent radii (2,) in px of each frame; NaN if unknown.
    joints : list[Floats]
        Joint values (3,) at each frame.
    """

    points: list[Floats] = field(default_factory=list[Floats])
    sizes: list[Floats] = field(default_factory=list[Floats])
    joints: list[Floats] = field(default_factory=list[Floats])

    def add(self, seen: Observation) -> None:
        """Add the newest frame of a tick."""
        self.points.append(seen.points)
        self.sizes.append(seen.sizes)
        self.joints.append(seen.q)

    def target(self, since: int) -> Target:
        """Return the mean of the frames as a target that was taught from a time (ns) on. A size is
        the mean over the frames that have it.
        """
        points, q = np.mean(self.points, axis=0), np.mean(self.joints, axis=0)
        return Target(points, q, since, mean_known(np.array(self.sizes)))

    def disagreement(self) -> str:
        """Return a sentence on why the frames make no target; empty if they agree."""
        deviation = np.abs(self.points - np.median(self.points, axis=0))
        noise = MAD_TO_STD * np.median(deviation, axis=0)
        is_outlier = deviation > OUTLIER_SIGMAS * np.maximum(noise, NOISE_FLOOR_PX)
        too_many = is_outlier.mean(axis=0) > MAX_OUTLIER_FRACTION
        unsteady = ((noise > MAX_NOISE_PX) | too_many).any(axis=1)
        if not unsteady.any():
            return ""
        which = " and ".join(f"marker {i + 1}" for i in np.flatnonzero(unsteady))
        return (
            f"{which} is seen in more than one place, {float(deviation.max()):.1f} px apart: see "
            "that nothing else looks like a marker and that the camera stands still"
        )
