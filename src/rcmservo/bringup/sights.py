"""What was seen at one place, and what was told on the way."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.interfaces import Floats


@dataclass(frozen=True, eq=False)
class Sight:
    """The joints and the markers at one place, at rest."""

    q: Floats
    """The joints (3,) as the arm told them, the mean."""
    points: Floats
    """The markers (2, 2) px, the mean over frames."""
    noise: float
    """px, the standard deviation of a coordinate in one frame."""
    frames: int
    """In which both markers were seen, and"""
    missed: int
    """in which not."""

    @property
    def mean_noise(self) -> float:
        """px, that of a coordinate of the mean."""
        return self.noise / float(np.sqrt(self.frames))


@dataclass(frozen=True, eq=False)
class Reach:
    """How far the markers may go in the picture before a motion ends where it is."""

    home: Floats
    """The markers (2, 2) px from where they go,"""
    px: float
    """and how far one of them may."""

    def left(self, points: Floats) -> bool:
        """Whether a marker (2, 2) that was seen is further away."""
        return bool((np.linalg.norm(points - self.home, axis=1) > self.px).any())


@dataclass(eq=False)
class Track:
    """All that was told while something moved."""

    answers: list[tuple[int, Floats, Floats]] = field(
        default_factory=list[tuple[int, Floats, Floats]]
    )
    """When the joints were read (ns), the joints (3,), and the rates (3,) taken before."""
    frames: list[tuple[int, int, Floats]] = field(default_factory=list[tuple[int, int, Floats]])
    """When a frame was exposed and when it arrived (ns), and its markers (2, 2) px."""
