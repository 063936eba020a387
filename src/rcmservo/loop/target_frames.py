"""Frames of a tool at rest that are averaged into a target, with a check that they agree."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rcmservo.constraints import between
from rcmservo.interfaces import Floats, Observation, Target, describe_swing

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

MAX_LEFT_OUT_FRACTION = 0.25
"""Largest fraction of the frames that may be left out; beyond it, the right ones are in doubt."""

SWING_BLOCKS = 20
"""Number of successive parts of the frames whose means show a slow motion of the markers."""

MIN_SWING_PX, MIN_SWING_SIGMAS = 1.0, 5.0
"""Smallest amplitude of such a motion, in px and in standard deviations of a mean by noise.

Air and focus move the markers by less than a px.
"""

MAX_SWING_STEP = 1.0
"""Largest change from part to part as a ratio of the motion; wrong detections change by 1.4."""

MAX_JOINT_MOTION = np.array([0.008, 0.008, 0.6])
"""Largest deviation (rad, rad, mm) of the joints from their median if the tool is held still."""

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
        """Return the mean of the frames that agree, as a target taught from `since` ns on.

        The mean of the radii covers only the frames in which they are known.
        """
        agrees = ~np.any(self._find_outliers(), axis=1)
        points, q = np.array(self.points)[agrees].mean(axis=0), np.array(self.joints)[agrees]
        radii = mean_of_finite(np.array(self.sizes)[agrees])
        left_out, swing_px = int((~agrees).sum()), self.measure_swing()
        return Target(points, q.mean(axis=0), since, radii, left_out, swing_px)

    def measure_swing(self) -> float:
        """Return the amplitude (px) of a slow motion of both markers; 0 if there is none.

        It is √2 times the standard deviation of the means of successive frames, as of a sine. Noise
        differs from frame to frame, so that differences of successive frames show it alone.
        """
        points = np.array(self.points).reshape(-1, 4)
        size = max(len(points) // SWING_BLOCKS, 1)
        blocks = len(points) // size
        if blocks < SWING_BLOCKS // 2:
            return 0.0
        means = np.median(points[: blocks * size].reshape(blocks, size, 4), axis=1)
        noise = MAD_TO_STD * np.median(np.abs(np.diff(points, axis=0)), axis=0) / np.sqrt(2.0)
        swing_px = np.sqrt(2.0) * _combine_axes(means.std(axis=0))
        steps_px = np.sqrt(2.0) * _combine_axes(np.diff(means, axis=0).std(axis=0))
        noise_px = _combine_axes(noise / np.sqrt(size))
        is_clear = swing_px > np.maximum(MIN_SWING_PX, MIN_SWING_SIGMAS * noise_px)
        is_slow = steps_px < MAX_SWING_STEP * swing_px
        return float(swing_px.min()) if (is_clear & is_slow).all() else 0.0

    def describe_disagreement(self) -> str:
        """Return a sentence on the disagreement of the frames; empty if enough of them agree."""
        joint_motion = np.abs(np.array(self.joints) - np.median(self.joints, axis=0)).max(axis=0)
        if not (joint_motion <= MAX_JOINT_MOTION).all():
            angle_1, angle_2, insertion = joint_motion
            return (
                f"the joints move by up to {angle_1:.3f} rad, {angle_2:.3f} rad and "
                f"{insertion:.1f} mm: hold the tool still"
            )
        is_outlier, is_noisy = self._find_outliers(), self._estimate_noise() > MAX_NOISE_PX
        is_left_out: NDArray[np.bool_] = np.any(is_outlier, axis=1)
        is_unsteady = np.any(is_noisy, axis=1)
        if is_left_out.mean() > MAX_LEFT_OUT_FRACTION:
            is_unsteady |= np.any(is_outlier, axis=0)
        if not is_unsteady.any():
            return ""
        swing_px = self.measure_swing()
        if swing_px > 0.0:
            return describe_swing(swing_px)
        markers = " and ".join(f"marker {i + 1}" for i in np.flatnonzero(is_unsteady))
        largest_px = float(self._compute_deviations().max())
        return (
            f"{markers} is detected at positions up to {largest_px:.1f} px apart: "
            "make sure that nothing else looks like a marker and that the camera does not move"
        )

    def _compute_deviations(self) -> Floats:
        """Return the absolute deviations (n, 2, 2) px of the markers from their median."""
        return np.abs(np.array(self.points) - np.median(self.points, axis=0))

    def _estimate_noise(self) -> Floats:
        """Return the noise (2, 2) px by the median deviation, which outliers do not change."""
        return MAD_TO_STD * np.median(self._compute_deviations(), axis=0)

    def _find_outliers(self) -> NDArray[np.bool_]:
        """Return which markers (n, 2) deviate from their median by more than noise."""
        limit_px = OUTLIER_SIGMAS * np.maximum(self._estimate_noise(), NOISE_FLOOR_PX)
        return np.any(self._compute_deviations() > limit_px, axis=2)


def _combine_axes(numbers: Floats) -> Floats:
    """Return the norm (2,) over the coordinates of each marker, from numbers (4,) of both."""
    norms: Floats = np.linalg.norm(numbers.reshape(2, 2), axis=1)
    return norms


def mean_of_finite(rows: Floats) -> Floats:
    """Return the mean of the finite entries of each column of (n, k); NaN if there are none."""
    is_finite = np.isfinite(rows)
    sums, counts = np.where(is_finite, rows, 0.0).sum(axis=0), is_finite.sum(axis=0)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
