"""Renderer of the tool in front of the tissue, with the noise of the camera's sensor."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rcmservo.constraints import not_negative
from rcmservo.errors import require
from rcmservo.interfaces import Floats, Image
from rcmservo.numerics.jit import compiled
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.rendering.capsules import build_capsules
from rcmservo.sim.rendering.coverage import build_tile_cones, find_touched_tiles, identify_capsules
from rcmservo.sim.rendering.lighting import build_lamp, build_shadow_nodes, cast_shadow
from rcmservo.sim.rendering.look import Appearance, Light
from rcmservo.sim.rendering.painting import PaintInputs, build_pattern, paint_capsules
from rcmservo.sim.rendering.tissue import Tissue, render_tissue

LightFilter = Callable[[Light], None]
"""Function that changes the light (H, W, 3) in place on its way to the sensor."""

POSE_COUNTS = (1, 2, 4, 8, 16)
"""Numbers of poses that share the samples of an outline evenly."""

NOISE_TABLE_SIZE = 1 << 21
"""Number of entries of the table of noise."""


class Renderer:
    """Renderer of the images of a static camera in front of static tissue.

    The same seed, frame number and poses give the same image, bit for bit.

    Parameters
    ----------
    optics : CameraModel
        True camera.
    look : Appearance
        Appearance of the scene.
    tissue : Tissue
        Plane behind the tool.
    seed : int
        Seed of the texture and the noise, at least 0.

    Raises
    ------
    BadInput
        If the seed is negative.
    """

    look: Appearance
    """Appearance of the tool and noise of the sensor. It may change between images; the tissue and
    the lamp keep their first appearance."""

    def __init__(self, optics: CameraModel, look: Appearance, tissue: Tissue, seed: int) -> None:
        not_negative("whole number").require("seed", seed)
        self.optics, self.look = optics, look
        self._seed, random = seed, np.random.default_rng(seed)
        self._pixel_rays = _compute_pixel_rays(optics)
        self._cones = build_tile_cones(optics)
        self._nodes = build_shadow_nodes(optics, tissue)
        slopes = self._pixel_rays[..., :2]
        self._tissue, self._lamp_fraction = render_tissue(slopes, optics, look, tissue, random)
        self._lamp = build_lamp(look)
        self._normals = random.standard_normal(NOISE_TABLE_SIZE, dtype=np.float32)
        self._canvas = np.empty_like(self._tissue)
        self._labels = np.empty((2, optics.height, optics.width), dtype=np.uint8)

    def render(self, poses: Floats, number: int, light_filter: LightFilter | None = None) -> Image:
        """Return the image (H, W, 3) of one exposure.

        Parameters
        ----------
        poses : Floats, shape (T, 4, 3)
            m1, m2, the shaft's start (at the RCM) and the tip in the world, mm, at T = 1, 2, 4, 8
            or 16 times spread evenly over the exposure. The shaft may start behind the camera.
        number : int
            Number of the frame, at least 0. Each frame has its own noise.
        light_filter : callable, optional
            Changes the light before it reaches the sensor.

        Raises
        ------
        BadInput
            If an argument has another shape or range.
        """
        valid = poses.ndim == 3 and poses.shape[1:] == (4, 3)
        require(valid, "poses' shape", poses.shape, "(T, 4, 3)")
        require(len(poses) in POSE_COUNTS, "number of poses", len(poses), f"one of {POSE_COUNTS}")
        require(bool(np.isfinite(poses).all()), "poses", poses, "finite")
        not_negative("whole number").require("number", number)
        self._paint(poses)
        if light_filter is not None:
            light_filter(self._canvas)
        return self._read_sensor(number)

    def _paint(self, poses: Floats) -> None:
        """Paint the light of one exposure on the canvas."""
        capsules = build_capsules(poses, self.optics, self.look)
        np.copyto(self._canvas, self._tissue)
        cast_shadow(self._canvas, self._lamp_fraction, self._nodes, capsules, self._lamp)
        touched = find_touched_tiles(self._cones, capsules)
        identify_capsules(self._labels, touched, self._pixel_rays, capsules)
        inputs = PaintInputs(self._pixel_rays, capsules, self._lamp, build_pattern(len(poses)))
        paint_capsules(self._canvas, self._labels, touched, inputs)

    def _read_sensor(self, number: int) -> Image:
        """Return the canvas as image (H, W, 3), with the noise of frame `number`.

        Each row reads the table of noise from a random position.
        """
        rows = self._canvas.reshape(len(self._canvas), -1)
        random = np.random.default_rng([self._seed, number])
        starts = random.integers(NOISE_TABLE_SIZE - rows.shape[1], size=len(rows))
        shot, dark = np.float32(255 / self.look.full_well), np.float32(self.look.read_noise**2)
        return add_noise(rows, self._normals, starts, shot, dark).reshape(self._canvas.shape)


def _compute_pixel_rays(optics: CameraModel) -> Floats:
    """Return each pixel's ray (x, y) and its change from pixel to pixel, (H, W, 6).

    The order is x, y, dx/du, dy/du, dx/dv, dy/dv.
    """
    slopes = optics.slopes(optics.pixels())
    return np.concatenate([slopes, *np.gradient(slopes, axis=(1, 0))], axis=2)


@compiled
def add_noise(
    rows: Light, normals: Light, starts: NDArray[np.int64], shot: np.float32, dark: np.float32
) -> Image:
    """Return light as clipped 8-bit grey levels with noise of variance `shot` · light + `dark`.

    The noise of row y is the table of standard `normals` from `starts`[y] on.
    """
    image = np.empty(rows.shape, dtype=np.uint8)
    half, black, white = np.float32(0.5), np.float32(0.0), np.float32(255.0)
    for y in range(rows.shape[0]):
        row, noise, grey = rows[y], normals[starts[y] : starts[y] + rows.shape[1]], image[y]
        for x in range(rows.shape[1]):
            value = row[x] + noise[x] * np.sqrt(shot * row[x] + dark) + half
            grey[x] = np.uint8(min(max(value, black), white))
    return image
