"""Smoke before the camera and blood on its lens: veils, which take light of the scene and add light
of their own.

A veil has no sharp edge, so it is worked out on a coarse grid and drawn out to the picture's size.
Lengths in px, time in s since the veil came.

    light = (1 − opacity) · scene + opacity · veil
"""

from abc import ABC, abstractmethod
from typing import NamedTuple, final

import cv2
import numpy as np
from numpy.typing import NDArray

from rcmservo.interfaces import Floats
from rcmservo.sim.rendering import Light, random_field, sampled

GRID = 4
"""px between the places at which a veil is worked out."""

FIELD = 256
"""Places across a random field, which repeats."""

COVERED = 0.8
"""Opacity from which on nothing behind it is found. A camera without pictures loses its markers
there."""


class Pane(NamedTuple):
    """A veil at one moment, on its grid."""

    opacity: Floats
    """(h, w) from 0 to 1."""

    colour: Floats
    """(h, w, 3) in light."""


class Veil(ABC):
    """Something between the scene and the sensor, for pictures of `size` (width, height) px."""

    def __init__(self, size: tuple[int, int], lasts: float) -> None:
        self.size, self.lasts = size, lasts
        width, height = size
        rows, columns = -(-height // GRID) + 1, -(-width // GRID) + 1
        self.v, self.u = GRID * np.indices((rows, columns)).astype(np.float64)

    @abstractmethod
    def pane(self, time: float) -> Pane:
        """The veil at `time` s."""

    def paint(self, light: Light, time: float) -> None:
        """Lay it over the light (H, W, 3) of a scene, in place."""
        width, height = self.size
        opacity, colour = self.pane(time)
        added = np.concatenate([opacity[..., None] * colour, 1.0 - opacity[..., None]], axis=-1)
        fine = _drawn_out(added.astype(np.float32))[:height, :width]
        light *= fine[..., 3:]
        light += fine[..., :3]

    def hides(self, points: Floats, time: float) -> NDArray[np.bool_]:
        """Return for each of `points` (n, 2) if it is covered."""
        opacity = self.pane(time).opacity
        edges = np.array(opacity.shape)[:, None] - 1.0
        return sampled(opacity, np.clip(points[:, ::-1].T / GRID, 0.0, edges)) > COVERED

    def present(self, time: float, coming: float, going: float) -> float:
        """How much of it is there, 0 to 1, if it takes so many s to come and to go.

        Both take at most a third of its time.
        """
        longest = self.lasts / 3.0
        share = min(time / min(coming, longest), (self.lasts - time) / min(going, longest), 1.0)
        return max(share, 0.0) ** 2 * (3.0 - 2.0 * max(share, 0.0))


@final
class Smoke(Veil):
    """Smoke that rises at the tool and drifts before the lamp: bright grey, soft, ever new."""

    COMES, GOES = 0.8, 1.0
    """s that it takes to come and to go."""

    DENSITY = 10.0
    """Its optical depth in the middle."""

    REACH = 0.62
    """Of the picture's width: how far the dense part extends."""

    def __init__(
        self, size: tuple[int, int], lasts: float, origin: Floats, random: np.random.Generator
    ) -> None:
        super().__init__(size, lasts)
        self._origin = origin
        self._billows = [_field(random, roughness) for roughness in (3.3, 3.3, 4.0)]
        self._winds = random.uniform(-1.0, 1.0, (3, 2)) * 0.16 * size[0] + np.array(
            [0.0, -0.05 * size[0]]
        )
        self._phases = random.uniform(0.0, 2.0 * np.pi, 2)

    def pane(self, time: float) -> Pane:
        there = self.present(time, self.COMES, self.GOES)
        width = self.size[0]
        first, second, slow = (self._seen(i, time) for i in range(3))
        billow = 0.6 * first + 0.5 * second
        centre = self._origin + 0.06 * width * (
            np.sin(0.7 * time + self._phases) - np.sin(self._phases)
        )
        reach = self.REACH * width * (0.45 + 0.55 * there) * (1.0 + 0.12 * slow)
        spread = np.exp(
            -((((self.u - centre[0]) ** 2 + (self.v - centre[1]) ** 2) / reach**2) ** 2)
        )
        depth = self.DENSITY * there * spread * np.exp(0.45 * np.clip(billow, -1.8, 1.8))
        across = np.hypot(self.u - width / 2.0, self.v - self.size[1] / 2.0) / width
        bright = (196.0 + 14.0 * slow + 16.0 * billow) * (1.0 - 0.55 * across**2)
        colour = np.clip(bright, 60.0, 250.0)[..., None] * np.array([1.0, 0.995, 0.985])
        return Pane(1.0 - np.exp(-depth), colour)

    def _seen(self, i: int, time: float) -> Floats:
        """The i-th billows over the picture, where their wind has carried them."""
        scale = FIELD / (1.5 * self.size[0])
        places = (
            np.stack([self.v - time * self._winds[i, 1], self.u - time * self._winds[i, 0]]) * scale
        )
        return sampled(self._billows[i], places)


@final
class Stain(Veil):
    """Blood splashed on the lens about the markers: dark red, opaque, thinner at its rim, with the
    lamp's glint on it."""

    COMES, GOES = 0.08, 0.15
    """s that it takes to come and to go."""

    FULL = 0.99
    """Opacity where it is thick."""

    EDGE = 0.16
    """Height, as a share of a drop's, over which the rim goes from clear to opaque."""

    def __init__(
        self, size: tuple[int, int], lasts: float, drops: Floats, random: np.random.Generator
    ) -> None:
        """`drops` (n, 3) px: u, v and radius of what must be covered. Smaller ones splash
        around."""
        super().__init__(size, lasts)
        all_drops = np.concatenate([drops, *(self._splashed(drop, random) for drop in drops)])
        scale = FIELD / (0.75 * size[0])
        places = np.stack([self.v, self.u]) * scale
        rough = sampled(_field(random, 3.6), places)
        height = self._merged(all_drops) + 0.16 * np.clip(rough, -2.0, 2.0)
        self._opacity = self.FULL * _blurred(_smooth(height / self.EDGE), 0.7)
        self._colour = self._shaded(np.clip(height, 0.0, 1.0), rough)

    def pane(self, time: float) -> Pane:
        return Pane(self.present(time, self.COMES, self.GOES) * self._opacity, self._colour)

    def _merged(self, drops: Floats) -> Floats:
        """How high blood stands: 0 about the rim of a drop and 1 in its middle. Drops that meet
        merge."""
        far = np.stack([np.hypot(self.u - u, self.v - v) / radius for u, v, radius in drops])
        return np.log(np.sum(np.exp(6.0 * (1.25 - np.minimum(far, 20.0))), axis=0)) / 6.0

    def _splashed(self, drop: Floats, random: np.random.Generator) -> Floats:
        count = int(random.integers(4, 9))
        way = random.uniform(0.0, 2.0 * np.pi, count)
        far = drop[2] * random.uniform(1.2, 3.0, count)
        radius = drop[2] * random.uniform(0.06, 0.3, count)
        return np.column_stack([drop[0] + far * np.cos(way), drop[1] + far * np.sin(way), radius])

    def _shaded(self, height: Floats, rough: Floats) -> Floats:
        """The colour (h, w, 3). Thin blood lets red light through, thick blood hardly any.

        Its slope mirrors the lamp, which is up on the left.
        """
        thick = _smooth(height / 0.55)[..., None]
        colour = thick * np.array([17.0, 14.0, 72.0]) + (1.0 - thick) * np.array(
            [32.0, 28.0, 150.0]
        )
        colour *= 1.0 + 0.1 * rough[..., None]
        dome = 7.0 * _blurred(np.sqrt(height), 1.0)
        normal = np.stack(
            [-np.gradient(dome, axis=1), -np.gradient(dome, axis=0), np.ones_like(dome)], axis=-1
        )
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        half = np.array([-0.45, -0.5, 0.74])
        glint = np.maximum(normal @ (half / np.linalg.norm(half)), 0.0) ** 150
        return np.clip(colour, 0.0, 255.0) + 170.0 * glint[..., None]


def _field(random: np.random.Generator, roughness: float) -> Floats:
    """A random field (FIELD, FIELD) of power 1/f^roughness."""
    return random_field(
        random,
        FIELD,
        lambda waves: np.where(waves > 0.0, np.maximum(waves, 2.0) ** (-roughness / 2.0), 0.0),
    )


def _blurred(values: Floats, spread: float) -> Floats:
    """Values (h, w) blurred by a Gaussian of this `spread`, in places."""
    return np.asarray(
        cv2.GaussianBlur(values, (0, 0), spread, borderType=cv2.BORDER_REFLECT), dtype=np.float64
    )


def _smooth(share: Floats) -> Floats:
    share = np.clip(share, 0.0, 1.0)
    return share**2 * (3.0 - 2.0 * share)


def _drawn_out(coarse: Light) -> Light:
    """The grid's values (h, w, n) at every pixel, linear between: ((h − 1) GRID, (w − 1) GRID,
    n)."""
    share: Light = (np.arange(GRID, dtype=np.float32) / np.float32(GRID))[:, None]
    rows = coarse[:-1, None] + share[:, None] * (coarse[1:] - coarse[:-1])[:, None]
    rows = rows.reshape(-1, *coarse.shape[1:])
    columns = rows[:, :-1, None] + share * (rows[:, 1:] - rows[:, :-1])[:, :, None]
    return columns.reshape(len(rows), -1, coarse.shape[2]).astype(np.float32, copy=False)
