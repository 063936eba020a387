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
        The measured joints (3,), the mean.
    points : Floats
        The markers (2, 2) px, the mean over frames.
    noise : float
        Standard deviation of a coordinate in one frame, px.
    frames : int
        Frames with both markers.
    missed : int
        Frames without.
    """

    q: Floats
    points: Floats
    noise: float
    frames: int
    missed: int

    @property
    def mean_noise(self) -> float:
        """Standard deviation of a coordinate of the mean, px."""
        return self.noise / float(np.sqrt(self.frames))


@dataclass(frozen=True, eq=False)
class PixelBound:
    """Bound on the motion of the markers in the picture, beyond which the joint turns back.

    Parameters
    ----------
    home : Floats
        The markers (2, 2) px from which it counts.
    px : float
        Largest distance from there.
    """

    home: Floats
    px: float

    def is_left(self, points: Floats) -> bool:
        """Return whether a visible marker (2, 2) is further away."""
        return bool((np.linalg.norm(points - self.home, axis=1) > self.px).any())


@dataclass(eq=False)
class MotionTrace:
    """All answers and frames of one motion.

    Parameters
    ----------
    answers : list[tuple[int, Floats, Floats]]
        Time of a measurement (ns), joints (3,), and the rates (3,) applied before.
    frames : list[tuple[int, int, Floats]]
        Exposure and arrival of a frame (ns), and its markers (2, 2) px.
    """

    answers: list[tuple[int, Floats, Floats]] = field(
        default_factory=list[tuple[int, Floats, Floats]]
    )
    frames: list[tuple[int, int, Floats]] = field(default_factory=list[tuple[int, int, Floats]])
