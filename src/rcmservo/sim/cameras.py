"""The simulated cameras: one makes pictures, the other tells where the markers' centres are."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Frame
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering import Between, Renderer
from rcmservo.sim.tool_body import Body

BLUR = 4
"""Moments per exposure at which the tool is drawn."""

Noise = Callable[[int], Floats]
"""What is added to both markers in the frame of this number, (2, 2) px."""


def by_chance(deviation: float, random: np.random.Generator) -> Noise:
    """Noise of a standard deviation in px, drawn when a frame is taken."""
    return lambda _: deviation * random.standard_normal((2, 2))


def in_order(noise: Floats, seen: int) -> Noise:
    """The given `noise` (frames, 2, 2) px, of the frames after number `seen`, whichever of them are
    taken."""
    good = noise.ndim == 3 and noise.shape[1:] == (2, 2)
    require(good, "noise", noise.shape, "of shape (frames, 2, 2)")

    def of(number: int) -> Floats:
        frames = number - seen
        require(frames <= len(noise), "noise", noise.shape, f"that of at least {frames} frames")
        return noise[frames - 1]

    return of


RATE = between(1.0, 1000.0, "a rate", "frames/s")
EXPOSURE = not_negative("time in s")
DELAY = between(0.0, 0.5, "a time", "s")


@dataclass(frozen=True)
class Timing(Checked, section="camera"):
    """When a camera takes its frames, and when they arrive."""

    frame_rate: Annotated[float, RATE] = 60.0
    """Frames per s."""

    exposure: Annotated[float, EXPOSURE] = 0.004
    """s for which a frame is exposed."""

    delay: Annotated[float, DELAY] = 0.02
    """s from the end of an exposure to the frame's arrival."""

    def __post_init__(self) -> None:
        super().__post_init__()
        short = self.exposure <= 1.0 / self.frame_rate
        self.require(short, "exposure", "a time from 0 s to one frame period")

    def newest(self, now: int) -> tuple[int, int, int]:
        """Number, exposure ns and arrival ns of the newest frame that has arrived.

        The number is -1 before the first frame.
        """
        period = 1e9 / self.frame_rate
        late = (0.5 * self.exposure + self.delay) * 1e9
        number = int(np.floor((now - late) / period + 1e-6))
        exposure = round(number * period)
        return number, exposure, exposure + round(late)


def moments(middle: int, length: float, count: int) -> list[int]:
    """`count` moments (ns), spread evenly over an exposure of `length` s about its `middle`."""
    return [
        middle + round(share * length * 1e9) for share in (np.arange(count) + 0.5) / count - 0.5
    ]


class SimulatedCamera(ABC):
    """A camera before the simulated arm. It takes a frame when somebody asks for the newest one."""

    def __init__(self, arm: SimulatedArm, body: Body, timing: Timing) -> None:
        self.arm, self.body, self.timing = arm, body, timing
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        number, exposure, arrival = self.timing.newest(self.arm.time)
        if number >= 0 and (self._frame is None or number > self._frame.number):
            self._frame = self.taken(number, exposure, arrival)
        return self._frame

    def points_at(self, time: int) -> Floats:
        """The points (4, 3) mm of the tool's body at a moment (ns) of the last second."""
        return self.body.points(self.arm.joints_at(time))

    @abstractmethod
    def taken(self, number: int, exposure: int, arrival: int) -> Frame:
        """The frame of this number, exposed about `exposure` ns."""

    @property
    @abstractmethod
    def optics(self) -> Optics:
        """The true camera: where it stands, and its lens."""


@final
class PictureCamera(SimulatedCamera):
    """A camera that makes pictures."""

    between: Between | None
    """Changes the light on its way to the sensor, if anything does."""

    def __init__(self, arm: SimulatedArm, body: Body, timing: Timing, renderer: Renderer) -> None:
        super().__init__(arm, body, timing)
        self.renderer, self.between = renderer, None

    def taken(self, number: int, exposure: int, arrival: int) -> Frame:
        times = moments(exposure, self.timing.exposure, BLUR)
        poses = np.stack([self.points_at(time) for time in times])
        image = self.renderer.render(poses, number, self.between)
        return Frame(number, exposure, arrival, image=image)

    @property
    def optics(self) -> Optics:
        return self.renderer.optics


@final
class PointCamera(SimulatedCamera):
    """A camera without pictures: it tells the centres of both markers, with noise."""

    noise: Noise
    """Of each frame."""

    def __init__(
        self,
        arm: SimulatedArm,
        body: Body,
        timing: Timing,
        optics: Optics,
        noise: Noise,
    ) -> None:
        super().__init__(arm, body, timing)
        self.noise, self._optics = noise, optics

    def taken(self, number: int, exposure: int, arrival: int) -> Frame:
        points = self.optics.project(self.points_at(exposure)[:2])
        points = points + self.noise(number)
        size = np.array([self.optics.width, self.optics.height])
        inside = ((points >= 0.0) & (points <= size - 1.0)).all(axis=1)
        points[~inside] = np.nan
        return Frame(number, exposure, arrival, points=points)

    @property
    def optics(self) -> Optics:
        return self._optics

    def move(self, optics: Optics) -> None:
        """Stand elsewhere from the next frame on."""
        self._optics = optics
