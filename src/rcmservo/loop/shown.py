"""What frames of a tool at rest show as a target, or why they do not agree on one."""

from dataclasses import dataclass, field

import numpy as np

from rcmservo.constraints import between
from rcmservo.interfaces import Floats, Observation, Target

TEACHING_FRAMES = 300
"""Frames that a target is the mean of by default: 5 s of a camera with 60 frames a second. At 1 px
of noise 98 % of runs then end within 1 mm, and 87 % with 30 frames; see docs/how_to_choose.md."""

MOST_FRAMES = 100_000
"""The most frames that a target may be the mean of."""

GAUSS = 1.4826
"""Standard deviations of noise in its median absolute deviation."""

NOISE = 2.0
"""px of noise of a marker that no camera with a sound tracker has."""

LEAST = 0.7
"""px of noise that is always allowed: a few frames tell the noise badly."""

OUTLYING = 6.0
"""Standard deviations from the median from which on a marker is not where it was."""

RARELY = 0.05
"""Share of the frames that may be so."""


FRAMES = between(1, MOST_FRAMES, "a whole number", "frames")
"""Limit to the numbers of frames that a target can be the mean of."""


def require_frames(frames: int, name: str = "frames") -> None:
    """Raise ``BadInput`` about a number of frames that no target can be the mean of."""
    FRAMES.require(name, frames)


def mean_known(rows: Floats) -> Floats:
    """The mean of each column of (n, k), of what is not NaN in it; NaN where all of it is."""
    known = np.isfinite(rows)
    total, count = np.where(known, rows, 0.0).sum(axis=0), known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass
class TargetFrames:
    """The frames that a target is made of."""

    points: list[Floats] = field(default_factory=list[Floats])
    """The markers (2, 2) px in each."""
    sizes: list[Floats] = field(default_factory=list[Floats])
    """Their apparent radii (2,) px in each, NaN where not known."""
    joints: list[Floats] = field(default_factory=list[Floats])
    """The joints (3,) beside it."""

    def add(self, seen: Observation) -> None:
        """Take the newest frame of a tick."""
        self.points.append(seen.points)
        self.sizes.append(seen.sizes)
        self.joints.append(seen.q)

    def target(self, since: int) -> Target:
        """Their mean, shown since so many ns. A size is that of the frames that tell it."""
        points, q = np.mean(self.points, axis=0), np.mean(self.joints, axis=0)
        return Target(points, q, since, mean_known(np.array(self.sizes)))

    def why_not(self) -> str:
        """Why they make no target; empty where they agree."""
        off = np.abs(self.points - np.median(self.points, axis=0))
        noise = GAUSS * np.median(off, axis=0)
        away = (off > OUTLYING * np.maximum(noise, LEAST)).mean(axis=0)
        unsteady = ((noise > NOISE) | (away > RARELY)).any(axis=1)
        if not unsteady.any():
            return ""
        which = " and ".join(f"marker {i + 1}" for i in np.flatnonzero(unsteady))
        return (
            f"{which} is seen in more than one place, {float(off.max()):.1f} px apart: see that "
            "nothing else looks like a marker and that the camera stands still"
        )
