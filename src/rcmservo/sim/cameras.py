"""Simulated cameras: one renders images, the other reports only the markers.

A frame is made when the software asks for it, from the joints that the arm had at the exposure.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from rcmservo.constraints import Checked, between, not_negative
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Frame
from rcmservo.sim.arm import SimulatedArm
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.imperfect_markers import BEND_INTERVAL_NS, compute_focus, compute_row_delay
from rcmservo.sim.rendering import LightFilter, Renderer
from rcmservo.sim.tool_body import ToolBody

POSES_PER_EXPOSURE = 4
"""Poses of the tool that one exposure averages."""

AIR_MEMORY_S = 0.5
"""Time (s) within which the slow motion of the markers by the air loses its memory."""

Noise = Callable[[int], Floats]
"""Function from a frame's number to the noise (2, 2) px of both markers."""


def make_gaussian_noise(deviation: float, random: np.random.Generator) -> Noise:
    """Return normal noise of a standard `deviation` in px, sampled when a frame is made."""
    return lambda _: deviation * random.standard_normal((2, 2))


def make_drifting_noise(
    deviation: float, air: float, frame_rate: float, random: np.random.Generator
) -> Noise:
    """Return normal noise like `make_gaussian_noise`, plus a slow motion of each marker.

    The motion has the standard deviation `air` px, and forgets its past within AIR_MEMORY_S.
    """
    newest, motion = [0], air * random.standard_normal((2, 2))

    def draw(number: int) -> Floats:
        motion[:] = step_air(motion, air, (number - newest[0]) / frame_rate, random)
        newest[0] = number
        return motion + deviation * random.standard_normal((2, 2))

    return draw


def step_air(motion: Floats, air: float, dt: float, random: np.random.Generator) -> Floats:
    """Return the slow motion (2, 2) px of the markers `dt` s later."""
    kept = np.exp(-abs(dt) / AIR_MEMORY_S)
    return kept * motion + air * np.sqrt(1.0 - kept**2) * random.standard_normal((2, 2))


def make_recorded_noise(noise: Floats, last_number: int) -> Noise:
    """Return the noise that an array lists for the frames after number `last_number`.

    Parameters
    ----------
    noise : Floats, shape (frames, 2, 2)
        Noise (px) of consecutive frame numbers, whether each frame is made or not.
    last_number : int
        Number of the frame before the first row of `noise`.
    """
    is_valid = noise.ndim == 3 and noise.shape[1:] == (2, 2)
    require(is_valid, "noise", noise.shape, "of shape (frames, 2, 2)")

    def read_noise(number: int) -> Floats:
        frames = number - last_number
        require(frames <= len(noise), "noise", noise.shape, f"of at least {frames} frames")
        return noise[frames - 1]

    return read_noise


@dataclass(frozen=True)
class Timing(Checked, section="camera"):
    """Frame rate, exposure and delay of a camera.

    Parameters
    ----------
    frame_rate : float
        Frame rate, frames/s; 1 to 1000.
    exposure : float
        Exposure time, s; from 0 to one frame period.
    delay : float
        Time (s) from the end of an exposure to the arrival of its frame; 0 to 0.5.

    Raises
    ------
    BadInput
        If a field is outside its range, or the exposure is longer than a frame period.
    """

    frame_rate: Annotated[float, between(1.0, 1000.0, "a rate", "frames/s")] = 60.0

    exposure: Annotated[float, not_negative("time in s")] = 0.004

    delay: Annotated[float, between(0.0, 0.5, "a time", "s")] = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        fits = self.exposure <= 1.0 / self.frame_rate
        self.require(fits, "exposure", "a time from 0 s to one frame period")

    def newest(self, now: int) -> tuple[int, int, int]:
        """Return number, exposure and arrival of the newest frame.

        Parameters
        ----------
        now : int
            Present time, ns. Only frames that have arrived by then count.

        Returns
        -------
        tuple of int
            Number, negative before the first frame; middle of the exposure (ns); arrival (ns).
        """
        period = 1e9 / self.frame_rate
        latency = (0.5 * self.exposure + self.delay) * 1e9
        number = int(np.floor((now - latency) / period + 1e-6))
        exposure = round(number * period)
        return number, exposure, exposure + round(latency)


class SimulatedCamera(ABC):
    """Camera that observes the simulated arm. It makes a frame when `latest` is called.

    Parameters
    ----------
    arm : SimulatedArm
        Arm whose joint history the camera reads.
    body : ToolBody
        Points of the tool.
    timing : Timing
        Frame rate, exposure and delay.
    optics : CameraModel
        Pose and lens; a disturbance may replace them between frames.
    """

    def __init__(
        self, arm: SimulatedArm, body: ToolBody, timing: Timing, optics: CameraModel
    ) -> None:
        self.arm, self.body, self.timing, self.optics = arm, body, timing, optics
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        """Return the newest frame that has arrived; None before the first one."""
        number, exposure, arrival = self.timing.newest(self.arm.time)
        if number >= 0 and (self._frame is None or number > self._frame.number):
            self._frame = self.make_frame(number, exposure, arrival)
        return self._frame

    def points_at(self, time: int) -> Floats:
        """Return `ToolBody.points` (4, 3) mm at a time (ns) within the last second."""
        joints_at = self.arm.joints_at
        return self.body.points(joints_at(time), joints_at(time - BEND_INTERVAL_NS), time)

    @property
    def stamp_error(self) -> int:
        """Reported minus true exposure time, ns."""
        return int(self.body.imperfections.stamp_error)

    @abstractmethod
    def make_frame(self, number: int, exposure: int, arrival: int) -> Frame:
        """Return a frame with the times (ns) of its exposure's middle and of its arrival."""


@final
class PictureCamera(SimulatedCamera):
    """Camera that renders images."""

    renderer: Renderer
    """Renderer of the scene for the present `optics`."""

    light_filter: LightFilter | None
    """Function that changes the light before it reaches the sensor, if a disturbance sets one."""

    def __init__(
        self, arm: SimulatedArm, body: ToolBody, timing: Timing, renderer: Renderer
    ) -> None:
        super().__init__(arm, body, timing, renderer.optics)
        self.renderer, self.light_filter = renderer, None

    def make_frame(self, number: int, exposure: int, arrival: int) -> Frame:
        """Return a frame with an image, blurred by the tool's motion during the exposure."""
        fractions = (np.arange(POSES_PER_EXPOSURE) + 0.5) / POSES_PER_EXPOSURE - 0.5
        times = [exposure + round(f * self.timing.exposure * 1e9) for f in fractions]
        poses = np.stack([self.points_at(time) for time in times])
        image = self.renderer.render(poses, number, self.light_filter)
        return Frame(number, exposure + self.stamp_error, arrival, image=image)


@final
class PointCamera(SimulatedCamera):
    """Camera without images: its frames hold the images of both markers' centres, with noise."""

    noise: Noise
    """Noise of each frame."""

    def __init__(
        self, arm: SimulatedArm, body: ToolBody, timing: Timing, optics: CameraModel, noise: Noise
    ) -> None:
        super().__init__(arm, body, timing, optics)
        self.noise = noise

    def make_frame(self, number: int, exposure: int, arrival: int) -> Frame:
        """Return a frame with the markers (2, 2) px, NaN where one is outside the image."""
        points = self._image_markers(exposure) + self.noise(number)
        size = np.array([self.optics.width, self.optics.height])
        inside = ((points >= 0.0) & (points <= size - 1.0)).all(axis=1)
        points[~inside] = np.nan
        return Frame(number, exposure + self.stamp_error, arrival, points=points)

    def _image_markers(self, exposure: int) -> Floats:
        """Return the markers (2, 2) px, each at the exposure of its row."""
        errors, markers = self.body.imperfections, self._image_markers_at(exposure)
        if errors.read_out > 0.0:
            for k in range(2):
                delay = compute_row_delay(errors.rows[0], markers[k, 1], self.optics.height)
                markers[k] = self._image_markers_at(exposure + delay)[k]
        return markers

    def _image_markers_at(self, time: int) -> Floats:
        """Return the markers (2, 2) px at `time` ns, with the focal length of then."""
        errors, images = self.body.imperfections, self.optics.project(self.points_at(time)[:2])
        if not errors.focus > 0.0:
            return images
        return self.optics.centre + compute_focus(errors.rows[0], time) * (
            images - self.optics.centre
        )
