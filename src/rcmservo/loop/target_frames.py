"""Frames of a tool at rest that are averaged into a target, with a check that they agree."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.constraints import between
from rcmservo.interfaces import Floats, Observation, Target

TEACHING_FRAMES = 300
"""Default number of frames that are averaged into a target: 5 s at 60 frames per second. At 1 px of
noise 98 % of runs then end within 1 mm, and 87 % with 30 frames; see docs/how_to_choose.md."""

MAX_FRAMES = 100_000
"""Largest number of frames that may be averaged into a target."""

MAD_TO_STD = 1.4826
"""Ratio of the standard deviation of Gaussian noise to its median absolute deviation."""

MAX_NOISE_PX = 2.0
"""Standard deviation in px above which a marker counts as unsteady; trackers usually have less."""

NOISE_FLOOR_PX = 0.7
"""Smallest standard deviation in px that the outlier test assumes: few frames may underestimate
it."""

OUTLIER_SIGMAS = 6.0
"""Distance from the median, in standard deviations, beyond which a marker is an outlier."""

MAX_OUTLIER_FRACTION = 0.05
"""Largest fraction of outliers among the frames."""

FRAME_COUNT = between(1, MAX_FRAMES, "a whole number", "frames")
"""Limits of the number of frames that are averaged into a target."""


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

    def add(self, observation: Observation) -> None:
        """Add the newest frame of a tick."""
        self.points.append(observation.points)
        self.sizes.append(observation.sizes)
        self.joints.append(observation.q)

    def compute_target(self, since: int) -> Target:
        """Return the mean of the frames as a target that was taught from `since` ns on.

        The mean of the radii covers only the frames in which they are known.
        """
        points, q = np.mean(self.points, axis=0), np.mean(self.joints, axis=0)
        return Target(points, q, since, mean_of_finite(np.array(self.sizes)))

    def describe_disagreement(self) -> str:
        """Return a sentence on the disagreement of the frames; empty if they agree.

        The noise is estimated from the median of the absolute deviations, which outliers do not
        change.
        """
        deviation_px = np.abs(self.points - np.median(self.points, axis=0))
        noise_px = MAD_TO_STD * np.median(deviation_px, axis=0)
        is_outlier = deviation_px > OUTLIER_SIGMAS * np.maximum(noise_px, NOISE_FLOOR_PX)
        has_outliers = is_outlier.mean(axis=0) > MAX_OUTLIER_FRACTION
        is_unsteady = ((noise_px > MAX_NOISE_PX) | has_outliers).any(axis=1)
        if not is_unsteady.any():
            return ""
        markers = " and ".join(f"marker {i + 1}" for i in np.flatnonzero(is_unsteady))
        return (
            f"{markers} is detected at positions up to {float(deviation_px.max()):.1f} px apart: "
            "make sure that nothing else looks like a marker and that the camera does not move"
        )


def mean_of_finite(rows: Floats) -> Floats:
    """Return the mean of the finite entries of each column of (n, k); NaN if there are none."""
    is_finite = np.isfinite(rows)
    sums, counts = np.where(is_finite, rows, 0.0).sum(axis=0), is_finite.sum(axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
