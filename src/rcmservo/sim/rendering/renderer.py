"""A camera that makes pictures of the tool over the tissue."""

from collections.abc import Callable

import numpy as np

from rcmservo.constraints import not_negative
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Image
from rcmservo.sim.optics import Optics
from rcmservo.sim.rendering.capsules import capsules_of
from rcmservo.sim.rendering.coverage import cones_of, identify, touch
from rcmservo.sim.rendering.light import lamp_of
from rcmservo.sim.rendering.look import Look
from rcmservo.sim.rendering.painting import Shot, paint, pattern_of
from rcmservo.sim.rendering.sensor import Sensor
from rcmservo.sim.rendering.shadow import cast_shadow, nodes_of
from rcmservo.sim.rendering.tissue import Tissue, lit
from rcmservo.sim.rendering.vectors import Light

Between = Callable[[Light], None]
"""Changes the light (H, W, 3) on its way to the sensor, in place."""

MOMENTS = (1, 2, 4, 8, 16)
"""How many moments of an exposure can share an outline's samples evenly."""


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
