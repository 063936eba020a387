"""Observations of joints and markers, at rest and in motion."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.interfaces import Floats


@dataclass(frozen=True, eq=False)
class StillView:
    """Joints and markers at one pose, at rest.

    Parameters
    ----------
    q : Floats
        Mean of the measured joints (3,) in rad, rad, mm.
    points : Floats
        Mean of the markers (2, 2) in px over the frames.
    noise : float
        Standard deviation (px) of a marker coordinate in one frame.
    frames : int
        Number of frames with both markers.
    missed : int
        Number of frames without both markers.
    """

    q: Floats
    points: Floats
    noise: float
    frames: int
    missed: int

    @property
    def mean_noise(self) -> float:
        """Standard deviation (px) of a coordinate of `points`."""
        return self.noise / float(np.sqrt(self.frames))


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Motion of one joint up, down and back, with the views at rest.

    Parameters
    ----------
    joint : int
        Index of the joint.
    size : float
        Agreed motion in either direction, rad or mm.
    views : list[StillView]
        Views above and below the initial position, and back there. The second one is missing if
        the first one exceeded the bound in the image.
    """

    joint: int
    size: float
    views: list[StillView]


@dataclass(frozen=True, eq=False)
class PixelBound:
    """Bound on the motion of the markers in the image. A joint returns if a marker exceeds it.

    Parameters
    ----------
    home : Floats
        Initial markers (2, 2) in px.
    radius_px : float
        Largest distance (px) of a marker from `home`.
    """

    home: Floats
    radius_px: float

    def is_exceeded(self, points: Floats) -> bool:
        """Return whether a visible marker of `points` (2, 2) is beyond the bound."""
        return bool((np.linalg.norm(points - self.home, axis=1) > self.radius_px).any())


@dataclass(eq=False)
class MotionTrace:
    """All answers and frames of one motion.

    Parameters
    ----------
    answers : list[tuple[int, Floats, Floats]]
        Time (ns) of each measurement, joints (3,), and rates (3,) applied before it.
    frames : list[tuple[int, int, Floats]]
        Exposure and arrival time (ns) of each frame, and its markers (2, 2) in px.
    """

    answers: list[tuple[int, Floats, Floats]] = field(
        default_factory=list[tuple[int, Floats, Floats]]
    )
    frames: list[tuple[int, int, Floats]] = field(default_factory=list[tuple[int, int, Floats]])
