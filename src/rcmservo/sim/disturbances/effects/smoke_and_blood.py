"""Smoke in front of the camera and blood on its lens: veils that absorb and add light.

    light = (1 − opacity) · light of the scene + opacity · colour of the veil

A veil has no sharp edge, so it is computed on a coarse grid and interpolated to the size of the
image. Lengths are in px, times in s since the start of the veil, colours and light in grey levels
(blue, green, red).
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, final

import cv2
import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.sim.rendering import Light, make_random_field, sample_field

GRID_STEP_PX = 4
"""Distance (px) of the grid's nodes."""

FIELD_SIZE = 256
"""Nodes along a side of a random field, which repeats."""

MARKER_LOST_OPACITY = 0.8
"""Opacity above which a tracker finds nothing. A camera without images loses its markers there."""


class Veil(ABC):
    """Layer between the scene and the sensor, which rises and falls smoothly.

    Parameters
    ----------
    size : tuple of int
        Width and height of the image, px.
    duration_s : float
        Duration of the veil, s.
    """

    RISE_TIME_S: ClassVar[float]
    """Time (s) in which the veil rises, at most a third of its duration."""

    FALL_TIME_S: ClassVar[float]
    """Time (s) in which the veil falls, at most a third of its duration."""

    def __init__(self, size: tuple[int, int], duration_s: float) -> None:
        self.size, self.duration_s = size, duration_s
        width, height = size
        rows, columns = -(-height // GRID_STEP_PX) + 1, -(-width // GRID_STEP_PX) + 1
        self.v, self.u = GRID_STEP_PX * np.indices((rows, columns)).astype(np.float64)

    @abstractmethod
    def layer_at(self, time: float) -> tuple[Floats, Floats]:
        """Return opacity (h, w) from 0 to 1 and colour (h, w, 3) on the grid at `time` s."""

    def paint(self, light: Light, time: float) -> None:
        """Lay the veil at `time` s over the light (H, W, 3) of a scene, in place."""
        width, height = self.size
        opacity, colour = self.layer_at(time)
        added = np.concatenate([opacity[..., None] * colour, 1.0 - opacity[..., None]], axis=-1)
        at_pixels = _upsample(added.astype(np.float32))[:height, :width]
        light *= at_pixels[..., 3:]
        light += at_pixels[..., :3]

    def hides(self, points: Floats, time: float) -> NDArray[np.bool_]:
        """Return for each of `points` (n, 2) px if the veil hides it at `time` s."""
        opacity, _ = self.layer_at(time)
        last_node = np.array(opacity.shape)[:, None] - 1.0
        nodes = np.clip(points[:, ::-1].T / GRID_STEP_PX, 0.0, last_node)
        return sample_field(opacity, nodes) > MARKER_LOST_OPACITY

    def fraction_at(self, time: float) -> float:
        """Return the fraction (0 to 1) to which the veil has risen at `time` s."""
        max_time = self.duration_s / 3.0
        risen = time / min(self.RISE_TIME_S, max_time)
        remaining = (self.duration_s - time) / min(self.FALL_TIME_S, max_time)
        fraction = max(min(risen, remaining, 1.0), 0.0)
        return fraction**2 * (3.0 - 2.0 * fraction)


@final
class Smoke(Veil):
    """Smoke that rises at the tool and drifts in front of the lamp: bright grey and soft.

    Its optical depth is the product of the risen fraction, a spread around the tool, and billows:
    two random fields that drift quickly and a third one that changes slowly.

    Parameters
    ----------
    size, duration_s
        See `Veil`.
    origin : Floats, shape (2,)
        Origin of the smoke, px.
    random : numpy.random.Generator
        Generator of random numbers.
    """

    RISE_TIME_S, FALL_TIME_S = 0.8, 1.0

    OPTICAL_DEPTH = 10.0
    """Optical depth at the centre."""

    RADIUS_RATIO = 0.62
    """Radius of the dense part, relative to the image's width."""

    BILLOW_ROUGHNESS = 3.3, 3.3, 4.0
    """Exponents of the power spectra of the three billows."""

    MAX_WIND, UPDRAFT = 0.16, -0.05
    """Largest random speed of the billows, and their speed upwards, in image widths per s."""

    def __init__(
        self, size: tuple[int, int], duration_s: float, origin: Floats, random: np.random.Generator
    ) -> None:
        super().__init__(size, duration_s)
        self._origin, width = origin, size[0]
        self._billows = [_make_field(random, roughness) for roughness in self.BILLOW_ROUGHNESS]
        gusts = random.uniform(-1.0, 1.0, (3, 2)) * self.MAX_WIND * width
        self._winds = gusts + np.array([0.0, self.UPDRAFT * width])
        self._phases = random.uniform(0.0, 2.0 * np.pi, 2)

    def layer_at(self, time: float) -> tuple[Floats, Floats]:
        """Return the opacity (h, w) and the colour (h, w, 3) of the smoke at `time` s."""
        fraction = self.fraction_at(time)
        width, height = self.size
        first, second, slow = (self._sample_billow(i, time) for i in range(3))
        billow = 0.6 * first + 0.5 * second
        sway = np.sin(0.7 * time + self._phases) - np.sin(self._phases)
        centre = self._origin + 0.06 * width * sway
        radius = self.RADIUS_RATIO * width * (0.45 + 0.55 * fraction) * (1.0 + 0.12 * slow)
        distance_squared = (self.u - centre[0]) ** 2 + (self.v - centre[1]) ** 2
        spread = np.exp(-((distance_squared / radius**2) ** 2))
        depth = self.OPTICAL_DEPTH * fraction * spread * np.exp(0.45 * np.clip(billow, -1.8, 1.8))
        off_axis = np.hypot(self.u - width / 2.0, self.v - height / 2.0) / width
        brightness = (196.0 + 14.0 * slow + 16.0 * billow) * (1.0 - 0.55 * off_axis**2)
        colour = np.clip(brightness, 60.0, 250.0)[..., None] * np.array([1.0, 0.995, 0.985])
        return 1.0 - np.exp(-depth), colour

    def _sample_billow(self, i: int, time: float) -> Floats:
        """Return the i-th random field (h, w) on the grid, displaced by its wind."""
        scale = FIELD_SIZE / (1.5 * self.size[0])
        u, v = self.u - time * self._winds[i, 0], self.v - time * self._winds[i, 1]
        return sample_field(self._billows[i], np.stack([v, u]) * scale)


@final
class BloodStain(Veil):
    """Blood on the lens over the markers: dark red, opaque, thin at its rim, with highlights.

    Parameters
    ----------
    size, duration_s
        See `Veil`.
    drops : Floats, shape (n, 3)
        Centre u, v and radius (px) of the drops that must be covered. Smaller drops surround them.
    random : numpy.random.Generator
        Generator of random numbers.
    """

    RISE_TIME_S, FALL_TIME_S = 0.08, 0.15

    MAX_OPACITY = 0.99
    """Opacity of thick blood."""

    RIM_HEIGHT = 0.16
    """Height, relative to that of a drop, over which the rim becomes opaque."""

    THICK_COLOUR = np.array([17.0, 14.0, 72.0])
    """Colour of thick blood, which transmits hardly any light."""

    THIN_COLOUR = np.array([32.0, 28.0, 150.0])
    """Colour of thin blood, which transmits red light."""

    HIGHLIGHT_DIRECTION = np.array([-0.45, -0.5, 0.74])
    """Direction half-way between the camera and the lamp at the upper left; not a unit vector."""

    def __init__(
        self, size: tuple[int, int], duration_s: float, drops: Floats, random: np.random.Generator
    ) -> None:
        super().__init__(size, duration_s)
        splashes = [self._sample_splashes(drop, random) for drop in drops]
        scale = FIELD_SIZE / (0.75 * size[0])
        roughness = sample_field(_make_field(random, 3.6), np.stack([self.v, self.u]) * scale)
        smooth_height = self._compute_height(np.concatenate([drops, *splashes]))
        height = smooth_height + 0.16 * np.clip(roughness, -2.0, 2.0)
        self._opacity = self.MAX_OPACITY * _blur(_smoothstep(height / self.RIM_HEIGHT), 0.7)
        self._colour = self._shade(np.clip(height, 0.0, 1.0), roughness)

    def layer_at(self, time: float) -> tuple[Floats, Floats]:
        """Return the opacity (h, w) and the colour (h, w, 3) of the blood at `time` s."""
        return self.fraction_at(time) * self._opacity, self._colour

    def _compute_height(self, drops: Floats) -> Floats:
        """Return the height (h, w) of the blood: 0 at a drop's rim, 1 in its middle.

        Drops that meet merge.
        """
        distance = np.stack([np.hypot(self.u - u, self.v - v) / radius for u, v, radius in drops])
        return np.log(np.sum(np.exp(6.0 * (1.25 - np.minimum(distance, 20.0))), axis=0)) / 6.0

    def _sample_splashes(self, drop: Floats, random: np.random.Generator) -> Floats:
        """Return random small drops (n, 3) around a drop."""
        u, v, drop_radius = drop
        count = int(random.integers(4, 9))
        angle = random.uniform(0.0, 2.0 * np.pi, count)
        distance = drop_radius * random.uniform(1.2, 3.0, count)
        radius = drop_radius * random.uniform(0.06, 0.3, count)
        return np.stack([u + distance * np.cos(angle), v + distance * np.sin(angle), radius], 1)

    def _shade(self, height: Floats, roughness: Floats) -> Floats:
        """Return the colour (h, w, 3), with highlights where the slope reflects the lamp."""
        thickness = _smoothstep(height / 0.55)[..., None]
        colour = thickness * self.THICK_COLOUR + (1.0 - thickness) * self.THIN_COLOUR
        colour *= 1.0 + 0.1 * roughness[..., None]
        dome = 7.0 * _blur(np.sqrt(height), 1.0)
        slope_v, slope_u = np.gradient(dome)
        normal = np.stack([-slope_u, -slope_v, np.ones_like(dome)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        half = self.HIGHLIGHT_DIRECTION / np.linalg.norm(self.HIGHLIGHT_DIRECTION)
        glint = np.maximum(normal @ half, 0.0) ** 150
        return np.clip(colour, 0.0, 255.0) + 170.0 * glint[..., None]


def _make_field(random: np.random.Generator, roughness: float) -> Floats:
    """Return a random field (FIELD_SIZE, FIELD_SIZE) with a power spectrum 1/f^roughness."""

    def amplitude(waves: Floats) -> Floats:
        return np.where(waves > 0.0, np.maximum(waves, 2.0) ** (-roughness / 2.0), 0.0)

    return make_random_field(random, FIELD_SIZE, amplitude)


def _blur(values: Floats, deviation: float) -> Floats:
    """Blur values (h, w) by a Gaussian with a standard `deviation` in nodes."""
    blurred: Any = cv2.GaussianBlur(values, (0, 0), deviation, borderType=cv2.BORDER_REFLECT)
    return blurred


def _smoothstep(values: Floats) -> Floats:
    """Return the smoothstep function of values clipped to 0 to 1."""
    values = np.clip(values, 0.0, 1.0)
    return values**2 * (3.0 - 2.0 * values)


def _upsample(coarse: Light) -> Light:
    """Interpolate values (h, w, n) on the grid linearly to every pixel.

    Returns
    -------
    Light, shape ((h − 1) GRID_STEP_PX, (w − 1) GRID_STEP_PX, n)
        Values at the pixels.
    """
    weights: Light = (np.arange(GRID_STEP_PX, dtype=np.float32) / np.float32(GRID_STEP_PX))[:, None]
    rows = coarse[:-1, None] + weights[:, None] * (coarse[1:] - coarse[:-1])[:, None]
    rows = rows.reshape(-1, *coarse.shape[1:])
    columns = rows[:, :-1, None] + weights * (rows[:, 1:] - rows[:, :-1])[:, :, None]
    return columns.reshape(len(rows), -1, coarse.shape[2]).astype(np.float32, copy=False)
