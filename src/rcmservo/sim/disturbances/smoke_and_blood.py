"""Smoke in front of the camera and blood on its lens: veils that absorb and add light.

A veil has no sharp edge, so it is computed on a coarse grid and interpolated to the image's size.
Lengths in px, time in s since the start of the veil.

    light = (1 − opacity) · scene + opacity · veil
"""

from abc import ABC, abstractmethod
from typing import NamedTuple, final

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


class VeilLayer(NamedTuple):
    """Veil at one time, on its grid.

    Parameters
    ----------
    opacity : Floats
        Opacity (h, w) from 0 to 1.
    colour : Floats
        Light (h, w, 3) of the veil, grey levels.
    """

    opacity: Floats

    colour: Floats


class Veil(ABC):
    """Layer between the scene and the sensor.

    Parameters
    ----------
    size : tuple of int
        Width and height of the image, px.
    lasts : float
        Duration of the veil, s.
    """

    def __init__(self, size: tuple[int, int], lasts: float) -> None:
        self.size, self.lasts = size, lasts
        width, height = size
        rows, columns = -(-height // GRID_STEP_PX) + 1, -(-width // GRID_STEP_PX) + 1
        self.v, self.u = GRID_STEP_PX * np.indices((rows, columns)).astype(np.float64)

    @abstractmethod
    def layer_at(self, time: float) -> VeilLayer:
        """Return the veil at `time` s."""

    def paint(self, light: Light, time: float) -> None:
        """Lay the veil at `time` s over the light (H, W, 3) of a scene, in place."""
        width, height = self.size
        opacity, colour = self.layer_at(time)
        added = np.concatenate([opacity[..., None] * colour, 1.0 - opacity[..., None]], axis=-1)
        fine = _upsample(added.astype(np.float32))[:height, :width]
        light *= fine[..., 3:]
        light += fine[..., :3]

    def hides(self, points: Floats, time: float) -> NDArray[np.bool_]:
        """Return for each of `points` (n, 2) px if the veil hides it at `time` s."""
        opacity = self.layer_at(time).opacity
        edges = np.array(opacity.shape)[:, None] - 1.0
        return (
            sample_field(opacity, np.clip(points[:, ::-1].T / GRID_STEP_PX, 0.0, edges))
            > MARKER_LOST_OPACITY
        )

    def fraction_at(self, time: float, rise_time: float, fall_time: float) -> float:
        """Return the fraction (0 to 1) of the veil at `time` s, which rises and falls smoothly.

        Parameters
        ----------
        time : float
            Time since the start, s.
        rise_time, fall_time : float
            Rise and fall time, s; each is at most a third of the duration.
        """
        longest = self.lasts / 3.0
        fraction = min(
            time / min(rise_time, longest), (self.lasts - time) / min(fall_time, longest), 1.0
        )
        return max(fraction, 0.0) ** 2 * (3.0 - 2.0 * max(fraction, 0.0))


@final
class Smoke(Veil):
    """Smoke that rises at the tool and drifts in front of the lamp: bright grey and soft.

    Parameters
    ----------
    size, lasts
        See `Veil`.
    origin : Floats, shape (2,)
        Origin of the smoke, px.
    random : numpy.random.Generator
        Generator of random numbers.
    """

    RISE_TIME_S, FALL_TIME_S = 0.8, 1.0
    """Rise and fall time, s."""

    OPTICAL_DEPTH = 10.0
    """Optical depth at the centre."""

    RADIUS_FRACTION = 0.62
    """Radius of the dense part, as a fraction of the image's width."""

    def __init__(
        self, size: tuple[int, int], lasts: float, origin: Floats, random: np.random.Generator
    ) -> None:
        super().__init__(size, lasts)
        self._origin = origin
        self._billows = [_power_law_field(random, roughness) for roughness in (3.3, 3.3, 4.0)]
        self._winds = random.uniform(-1.0, 1.0, (3, 2)) * 0.16 * size[0] + np.array(
            [0.0, -0.05 * size[0]]
        )
        self._phases = random.uniform(0.0, 2.0 * np.pi, 2)

    def layer_at(self, time: float) -> VeilLayer:
        fraction = self.fraction_at(time, self.RISE_TIME_S, self.FALL_TIME_S)
        width = self.size[0]
        first, second, slow = (self._billow_at(i, time) for i in range(3))
        billow = 0.6 * first + 0.5 * second
        centre = self._origin + 0.06 * width * (
            np.sin(0.7 * time + self._phases) - np.sin(self._phases)
        )
        reach = self.RADIUS_FRACTION * width * (0.45 + 0.55 * fraction) * (1.0 + 0.12 * slow)
        spread = np.exp(
            -((((self.u - centre[0]) ** 2 + (self.v - centre[1]) ** 2) / reach**2) ** 2)
        )
        depth = self.OPTICAL_DEPTH * fraction * spread * np.exp(0.45 * np.clip(billow, -1.8, 1.8))
        across = np.hypot(self.u - width / 2.0, self.v - self.size[1] / 2.0) / width
        bright = (196.0 + 14.0 * slow + 16.0 * billow) * (1.0 - 0.55 * across**2)
        colour = np.clip(bright, 60.0, 250.0)[..., None] * np.array([1.0, 0.995, 0.985])
        return VeilLayer(1.0 - np.exp(-depth), colour)

    def _billow_at(self, i: int, time: float) -> Floats:
        """Return the i-th random field over the image, displaced by its wind."""
        scale = FIELD_SIZE / (1.5 * self.size[0])
        positions = (
            np.stack([self.v - time * self._winds[i, 1], self.u - time * self._winds[i, 0]]) * scale
        )
        return sample_field(self._billows[i], positions)


@final
class Stain(Veil):
    """Blood on the lens over the markers: dark red, opaque, thin at its rim, with highlights.

    Parameters
    ----------
    size, lasts
        See `Veil`.
    drops : Floats, shape (n, 3)
        Centre u, v and radius (px) of the drops that must be covered. Smaller ones surround them.
    random : numpy.random.Generator
        Generator of random numbers.
    """

    RISE_TIME_S, FALL_TIME_S = 0.08, 0.15
    """Rise and fall time, s."""

    MAX_OPACITY = 0.99
    """Opacity of thick blood."""

    RIM_HEIGHT = 0.16
    """Height, as a fraction of a drop's, over which the rim becomes opaque."""

    def __init__(
        self, size: tuple[int, int], lasts: float, drops: Floats, random: np.random.Generator
    ) -> None:
        super().__init__(size, lasts)
        all_drops = np.concatenate(
            [drops, *(self._splash_droplets(drop, random) for drop in drops)]
        )
        scale = FIELD_SIZE / (0.75 * size[0])
        positions = np.stack([self.v, self.u]) * scale
        rough = sample_field(_power_law_field(random, 3.6), positions)
        height = self._blood_height(all_drops) + 0.16 * np.clip(rough, -2.0, 2.0)
        self._opacity = self.MAX_OPACITY * _blur(_smoothstep(height / self.RIM_HEIGHT), 0.7)
        self._colour = self._shade(np.clip(height, 0.0, 1.0), rough)

    def layer_at(self, time: float) -> VeilLayer:
        return VeilLayer(
            self.fraction_at(time, self.RISE_TIME_S, self.FALL_TIME_S) * self._opacity, self._colour
        )

    def _blood_height(self, drops: Floats) -> Floats:
        """Return the height of the blood: 0 at a drop's rim, 1 in its middle.

        Drops that meet merge.
        """
        distance = np.stack([np.hypot(self.u - u, self.v - v) / radius for u, v, radius in drops])
        return np.log(np.sum(np.exp(6.0 * (1.25 - np.minimum(distance, 20.0))), axis=0)) / 6.0

    def _splash_droplets(self, drop: Floats, random: np.random.Generator) -> Floats:
        """Return random small drops (n, 3) around a drop."""
        count = int(random.integers(4, 9))
        angle = random.uniform(0.0, 2.0 * np.pi, count)
        distance = drop[2] * random.uniform(1.2, 3.0, count)
        radius = drop[2] * random.uniform(0.06, 0.3, count)
        return np.column_stack(
            [drop[0] + distance * np.cos(angle), drop[1] + distance * np.sin(angle), radius]
        )

    def _shade(self, height: Floats, rough: Floats) -> Floats:
        """Return the colour (h, w, 3). Thin blood transmits red light, thick blood hardly any.

        Its slope reflects the lamp, which is at the upper left.
        """
        thick = _smoothstep(height / 0.55)[..., None]
        colour = thick * np.array([17.0, 14.0, 72.0]) + (1.0 - thick) * np.array(
            [32.0, 28.0, 150.0]
        )
        colour *= 1.0 + 0.1 * rough[..., None]
        dome = 7.0 * _blur(np.sqrt(height), 1.0)
        normal = np.stack(
            [-np.gradient(dome, axis=1), -np.gradient(dome, axis=0), np.ones_like(dome)], axis=-1
        )
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        half = np.array([-0.45, -0.5, 0.74])
        glint = np.maximum(normal @ (half / np.linalg.norm(half)), 0.0) ** 150
        return np.clip(colour, 0.0, 255.0) + 170.0 * glint[..., None]


def _power_law_field(random: np.random.Generator, roughness: float) -> Floats:
    """Return a random field (FIELD_SIZE, FIELD_SIZE) with a power spectrum 1/f^roughness."""
    return make_random_field(
        random,
        FIELD_SIZE,
        lambda waves: np.where(waves > 0.0, np.maximum(waves, 2.0) ** (-roughness / 2.0), 0.0),
    )


def _blur(values: Floats, spread: float) -> Floats:
    """Blur values (h, w) by a Gaussian with a standard deviation in nodes."""
    return np.asarray(
        cv2.GaussianBlur(values, (0, 0), spread, borderType=cv2.BORDER_REFLECT), dtype=np.float64
    )


def _smoothstep(values: Floats) -> Floats:
    """Return the smoothstep function of values clipped to 0 to 1."""
    values = np.clip(values, 0.0, 1.0)
    return values**2 * (3.0 - 2.0 * values)


def _upsample(coarse: Light) -> Light:
    """Interpolate the grid's values (h, w, n) linearly to every pixel.

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
