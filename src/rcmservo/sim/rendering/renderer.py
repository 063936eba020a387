"""A camera that makes pictures of the tool over the tissue."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled
from rcmservo.constraints import not_negative
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Image
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering.capsules import capsules_of
from rcmservo.sim.rendering.coverage import cones_of, identify, touch
from rcmservo.sim.rendering.lighting import cast_shadow, lamp_of, nodes_of
from rcmservo.sim.rendering.look import Light, Look
from rcmservo.sim.rendering.painting import Shot, paint, pattern_of
from rcmservo.sim.rendering.tissue import Tissue, lit

Between = Callable[[Light], None]
"""Changes the light (H, W, 3) on its way to the sensor, in place."""

MOMENTS = (1, 2, 4, 8, 16)
"""How many moments of an exposure can share an outline's samples evenly."""

NORMALS = 1 << 21
"""Entries in the table of standard normal numbers."""


class Renderer:
    """A still camera before still tissue.

    The same seed, number and poses give the same picture, bit for bit.
    """

    look: Look
    """How the tool looks and how noisy the sensor is. It may change from picture to picture; the
    tissue and the lamp stay what they were at first."""

    def __init__(self, optics: Optics, look: Look, tissue: Tissue, seed: int) -> None:
        not_negative("whole number").require("seed", seed)
        self.optics, self.look = optics, look
        noise = np.random.default_rng(seed)
        self._rays = _rays(optics)
        self._cones = cones_of(optics)
        self._nodes = nodes_of(optics, tissue)
        self._tissue, self._lamp_share = lit(self._rays[..., :2], optics, look, tissue, noise)
        self._lamp = lamp_of(look)
        self._sensor = Sensor(seed, noise)
        self._canvas = np.empty_like(self._tissue)
        self._seen = np.empty((2, optics.height, optics.width), dtype=np.uint8)

    def render(self, poses: Floats, number: int, between: Between | None = None) -> Image:
        """The picture (H, W, 3) of one exposure, in which light may pass through what is
        `between`.

        `poses` (T, 4, 3) mm: m1, m2, the shaft's start (towards the RCM) and the tool's tip, in the
        world, at T = 1, 2, 4, 8 or 16 moments spread evenly over the exposure. The shaft may start
        behind the camera. `number` of the frame, at least 0: each frame has noise of its own.
        """
        good = poses.ndim == 3 and poses.shape[1:] == (4, 3)
        require(good, "poses' shape", poses.shape, "(T, 4, 3)")
        require(len(poses) in MOMENTS, "number of poses", len(poses), f"one of {MOMENTS}")
        require(bool(np.isfinite(poses).all()), "poses", poses, "finite")
        not_negative("whole number").require("number", number)
        self._paint(poses)
        if between is not None:
            between(self._canvas)
        return self._sensor.read(self._canvas, number, self.look)

    def _paint(self, poses: Floats) -> None:
        """Paint the light of one exposure on the canvas."""
        capsules = capsules_of(poses, self.optics, self.look)
        np.copyto(self._canvas, self._tissue)
        cast_shadow(self._canvas, self._lamp_share, self._nodes, capsules, self._lamp)
        touched = touch(self._cones, capsules)
        identify(self._seen, touched, self._rays, capsules)
        shot = Shot(self._rays, capsules, self._lamp, pattern_of(len(poses)))
        paint(self._canvas, self._seen, touched, shot)


def _rays(optics: Optics) -> Floats:
    """For each pixel x, y of the ray through its centre, and their changes from pixel to pixel: (H,
    W, 6).

    The order is x, y, dx/du, dy/du, dx/dv, dy/dv.
    """
    slopes = optics.slopes(optics.pixels())
    return np.concatenate([slopes, *np.gradient(slopes, axis=(1, 0))], axis=2)


class Sensor:
    """A sensor with a table of noise. Each frame starts in it at places of its own."""

    def __init__(self, seed: int, noise: np.random.Generator) -> None:
        self._seed = seed
        self._normals = noise.standard_normal(NORMALS, dtype=np.float32)

    def read(self, light: Light, number: int, look: Look) -> Image:
        """The picture of the light (H, W, 3) in frame `number`."""
        rows = light.reshape(len(light), -1)
        random = np.random.default_rng([self._seed, number])
        starts = random.integers(NORMALS - rows.shape[1], size=len(rows))
        shot, dark = np.float32(255 / look.full_well), np.float32(look.read_noise**2)
        return expose(rows, self._normals, starts, shot, dark).reshape(light.shape)


@compiled
def expose(
    rows: Light, normals: Light, starts: NDArray[np.int64], shot: np.float32, dark: np.float32
) -> Image:
    """Light as 8-bit grey levels, clipped, with noise of variance `shot` times the light plus
    `dark`.

    The noise of row y is the table of standard `normals` from `starts`[y] on.
    """
    picture = np.empty(rows.shape, dtype=np.uint8)
    half, black, white = np.float32(0.5), np.float32(0.0), np.float32(255.0)
    for y in range(rows.shape[0]):
        row, noise, grey = rows[y], normals[starts[y] : starts[y] + rows.shape[1]], picture[y]
        for x in range(rows.shape[1]):
            value = row[x] + noise[x] * np.sqrt(shot * row[x] + dark) + half
            grey[x] = np.uint8(min(max(value, black), white))
    return picture
