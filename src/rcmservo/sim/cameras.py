"""Simulated cameras: one makes pictures, the other delivers the markers' projected centres with
noise."""

from dataclasses import dataclass

import numpy as np

from rcmservo.errors import require
from rcmservo.interfaces import Floats, Frame
from rcmservo.method.kinematics import Kinematics
from rcmservo.method.tool import Tool
from rcmservo.sim.optics import Optics
from rcmservo.sim.renderer import Between, Renderer
from rcmservo.sim.world import World, moments

BLUR = 4
"""Moments per exposure at which the tool is drawn."""

TIP = 14.0
"""mm by which the instrument's tip stands out beyond marker 2."""


@dataclass(frozen=True)
class Timing:
    """``frame_rate`` 1/s; ``exposure`` s is how long a frame is exposed, ``delay`` s how long after
    that it arrives."""

    frame_rate: float = 60.0
    exposure: float = 0.004
    delay: float = 0.02

    def __post_init__(self) -> None:
        require(
            1.0 <= self.frame_rate <= 1000.0,
            "camera.frame_rate",
            self.frame_rate,
            "from 1 to 1000 frames/s",
        )
        short = 0.0 <= self.exposure <= 1.0 / self.frame_rate
        require(short, "camera.exposure", self.exposure, "a time from 0 s to one frame period")
        require(0.0 <= self.delay <= 0.5, "camera.delay", self.delay, "a time from 0 to 0.5 s")

    def newest(self, now: int) -> tuple[int, int, int]:
        """Number, exposure ns and arrival ns of the newest frame that has arrived; number -1 before
        the first."""
        period = 1e9 / self.frame_rate
        late = (0.5 * self.exposure + self.delay) * 1e9
        number = int(np.floor((now - late) / period + 1e-6))
        exposure = round(number * period)
        return number, exposure, exposure + round(late)


class Body:
    """The tool in space: where the joints put its markers, its tip, and the shaft up to the RCM."""

    def __init__(self, kinematics: Kinematics, tool: Tool) -> None:
        self.kinematics, self.tool = kinematics, tool

    def points(self, q: Floats) -> Floats:
        """m₁, m₂, the shaft's start at the RCM and the tip, (4, 3) mm, at the joints q (3,)."""
        reference = self.kinematics.position(q)
        n = reference / np.linalg.norm(reference)
        p1 = reference + self.tool.offset * n
        p2 = self.tool.second_marker(p1)
        return np.stack([p1, p2, np.zeros(3), p2 + TIP * n])


class PictureCamera:
    """A camera that renders what it sees, once per frame, when the frame is asked for.

    ``between`` is what changes the light on its way to the sensor, if anything.
    """

    def __init__(self, world: World, body: Body, renderer: Renderer, timing: Timing) -> None:
        self.world, self.body, self.renderer, self.timing = world, body, renderer, timing
        self.between: Between | None = None
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        number, exposure, arrival = self.timing.newest(self.world.now())
        if number >= 0 and (self._frame is None or number > self._frame.number):
            times = moments(exposure, self.timing.exposure, BLUR)
            poses = np.stack([self.body.points(self.world.joints_at(time)) for time in times])
            self._frame = Frame(
                number, exposure, arrival, image=self.renderer.render(poses, number, self.between)
            )
        return self._frame


class PointCamera:
    """A camera without pictures: the centres of both markers with `noise` px (standard deviation),
    NaN outside."""

    def __init__(
        self,
        world: World,
        body: Body,
        optics: Optics,
        timing: Timing,
        noise: float,
        random: np.random.Generator,
    ) -> None:
        self.world, self.body, self.optics, self.timing = world, body, optics, timing
        self.noise, self.random = noise, random
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        number, exposure, arrival = self.timing.newest(self.world.now())
        if number >= 0 and (self._frame is None or number > self._frame.number):
            points = self.optics.project(self.body.points(self.world.joints_at(exposure))[:2])
            points = points + self.noise * self.random.standard_normal((2, 2))
            size = np.array([self.optics.width, self.optics.height])
            inside = ((points >= 0.0) & (points <= size - 1.0)).all(axis=1)
            points[~inside] = np.nan
            self._frame = Frame(number, exposure, arrival, points=points)
        return self._frame
