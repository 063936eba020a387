"""A circle in space as moving reference pixels, and how a tool went round it."""

from dataclasses import dataclass

import numpy as np

from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.statistics import rms
from rcmservo.interfaces import Floats, Target
from rcmservo.sim import Rig

NEAR_END = 0.2
"""s before the end of a path at which it counts as completed: two looks."""

LONGEST_LAG = 2.0
"""s up to which the lag behind a path is looked for."""


@dataclass(frozen=True, eq=False)
class Circle:
    """A path of marker 1 in the rig's space, oblique to the tool, so that it asks for yaw, pitch
    and insertion."""

    rig: Rig
    """The laboratory, whose true camera gives the reference pixels."""
    middle: Floats
    """p₁ (3,) mm at the target."""
    across: Floats
    """A radius (3,) mm."""
    along: Floats
    """A radius (3,) mm at right angles to the other."""
    period: float
    """s."""

    def p1(self, time: float) -> Floats:
        """Where marker 1 should be `time` s after the start, (3,) mm; before it, at the first
        point."""
        angle = 2.0 * np.pi * max(time, 0.0) / self.period
        return self.middle + np.cos(angle) * self.across + np.sin(angle) * self.along

    def reference(self, time: float) -> Target:
        """What the servo is to see `time` s after the start."""
        q = self.rig.settings.mechanism.joints(self.p1(time))
        return Target(self.rig.truth.pixels(q), np.full(3, np.nan))


def circle(rig: Rig, radius: float, period: float) -> Circle:
    """The circle of `radius` mm about the scene's target, gone round in `period` s."""
    middle: Floats = rig.body.points(rig.scene.target)[0]
    n = middle / np.linalg.norm(middle)
    axis: Floats = np.eye(3)[np.argmin(np.abs(n))]
    across = np.cross(n, axis)
    across /= np.linalg.norm(across)
    along = (np.cross(n, across) + n) / np.sqrt(2.0)
    return Circle(rig, middle, radius * across, radius * along, period)


@dataclass(frozen=True)
class PathWay:
    """A path gone round to its end."""

    rms: float
    """mm from the reference."""
    max: float
    """mm."""
    pixels_rms: float
    """px."""
    lag: float
    """s that explains most of the error."""
    beside: float
    """mm rms that are left then."""
    times: JsonFloats
    """s on the path."""
    errors: JsonFloats
    """mm."""
    seen: JsonFloats
    """px of marker 1 (n, 2)."""
    wanted: JsonFloats
    """px of the reference (n, 2)."""


class Trace:
    """Where marker 1 truly was along a path, and where it should have been."""

    def __init__(self, path: Circle) -> None:
        self.path = path
        self.began: int | None = None
        self._times: list[float] = []
        self._points: list[Floats] = []
        self._pixels: list[Floats] = []

    def look(self, time: float) -> None:
        """Take note of where marker 1 is now, `time` s after the start of the path."""
        rig = self.path.rig
        q = rig.arm.q_true
        self._times.append(time)
        self._points.append(rig.body.points(q)[0])
        self._pixels.append(rig.truth.pixels(q)[0])

    def way(self) -> PathWay | None:
        """The way round, or None if it was not gone to its end."""
        if not self._times or self._times[-1] <= self.path.period - NEAR_END:
            return None
        wanted = np.array([self.path.reference(time).points[0] for time in self._times])
        seen, errors = np.array(self._pixels), self._behind(0.0)
        lags = np.arange(0.0, LONGEST_LAG, 0.02)
        left = [rms(self._behind(lag)) for lag in lags]
        return PathWay(
            rms=rms(errors),
            max=float(errors.max()),
            pixels_rms=rms(np.linalg.norm(seen - wanted, axis=1)),
            lag=float(lags[np.argmin(left)]),
            beside=min(left),
            times=np.array(self._times),
            errors=errors,
            seen=seen,
            wanted=wanted,
        )

    def _behind(self, lag: float) -> Floats:
        """How far marker 1 was from where it should have been `lag` s before, mm, at every time."""
        wanted = np.array([self.path.p1(time - lag) for time in self._times])
        return np.linalg.norm(np.array(self._points) - wanted, axis=1)
