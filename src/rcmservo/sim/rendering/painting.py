"""Painting of the capsules over the tissue, with smooth outlines and motion blur.

A pixel inside an outline takes the light of one ray. A pixel on an outline takes the mean light of
`SAMPLES_PER_PIXEL` rays, spread over the pixel's area and the exposure.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.numerics.jit import compiled
from rcmservo.sim.rendering.capsules import (
    Capsules,
    find_first_capsule,
    intersect,
    read_capsule,
    scale,
)
from rcmservo.sim.rendering.coverage import TILE_PX, is_uniform
from rcmservo.sim.rendering.lighting import Lamp, shade
from rcmservo.sim.rendering.look import Light

SAMPLES_PER_PIXEL = 32
"""Number of rays through a pixel on an outline."""


class PaintInputs(NamedTuple):
    """Inputs of the painting of one image.

    Parameters
    ----------
    rays : Floats
        Rays (H, W, 6): x, y of each pixel's ray, and dx/du, dy/du, dx/dv, dy/dv.
    capsules : Capsules
        Tool during the exposure.
    lamp : Lamp
        Lamp.
    pattern : Floats
        Samples (SAMPLES_PER_PIXEL, 3) of a pixel on an outline: u, v (px) from the pixel's centre,
        and the index of the pose.
    """

    rays: Floats

    capsules: Capsules

    lamp: Lamp

    pattern: Floats


def build_pattern(poses: int) -> Floats:
    """Return the `pattern` of a pixel's samples for a number of poses.

    The positions are a lattice without a preferred direction, symmetric about the pixel's centre,
    so outlines of all directions are sampled evenly. Opposite positions have the same pose, so the
    mean position of each pose is the centre, and motion blur shifts no outline.
    """
    i = np.arange(SAMPLES_PER_PIXEL)
    u = (i + 0.5) / SAMPLES_PER_PIXEL - 0.5
    v = ((7 * i + 3) % SAMPLES_PER_PIXEL + 0.5) / SAMPLES_PER_PIXEL - 0.5
    pair = np.minimum(i, SAMPLES_PER_PIXEL - 1 - i)
    shuffled_pair = 5 * pair % (SAMPLES_PER_PIXEL // 2)
    return np.stack([u, v, 1 + shuffled_pair * poses // (SAMPLES_PER_PIXEL // 2)], axis=1)


@compiled
def paint_capsules(canvas: Light, labels: Image, touched: Image, inputs: PaintInputs) -> None:
    """Paint the capsules over the tissue on the canvas (H, W, 3)."""
    rays = inputs.rays
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            if touched[i, j] == 0:
                continue
            for y in range(i * TILE_PX, min((i + 1) * TILE_PX, rays.shape[0])):
                for x in range(j * TILE_PX, min((j + 1) * TILE_PX, rays.shape[1])):
                    if not is_uniform(labels, y, x):
                        paint_outline(canvas[y, x], rays[y, x], touched[i, j], inputs)
                    elif labels[0, y, x] > 0:
                        paint_inside(canvas[y, x], rays[y, x], labels[0, y, x] - 1, inputs)


@compiled
def paint_inside(pixel: Light, slopes: Floats, k: int, inputs: PaintInputs) -> None:
    """Set a `pixel` (3,) to the light of capsule `k` on the ray through the pixel's centre."""
    ray = (slopes[0], slopes[1], 1.0)
    capsule = read_capsule(inputs.capsules, 0, k)
    depth = intersect(ray, capsule)
    if depth < np.inf:
        pixel[0], pixel[1], pixel[2] = shade(scale(depth, ray), capsule, inputs.lamp)


@compiled
def paint_outline(pixel: Light, ray: Floats, bits: int, inputs: PaintInputs) -> None:
    """Replace a `pixel` (3,) of tissue by the mean light of its samples."""
    blue, green, red, tissue_samples = 0.0, 0.0, 0.0, 0
    for n in range(SAMPLES_PER_PIXEL):
        u, v, pose = inputs.pattern[n, 0], inputs.pattern[n, 1], int(inputs.pattern[n, 2])
        sample = (ray[0] + u * ray[2] + v * ray[4], ray[1] + u * ray[3] + v * ray[5], 1.0)
        k, depth = find_first_capsule(sample, inputs.capsules, pose, bits)
        if k < 0:
            tissue_samples += 1
        else:
            light = shade(scale(depth, sample), read_capsule(inputs.capsules, pose, k), inputs.lamp)
            blue, green, red = blue + light[0], green + light[1], red + light[2]
    pixel[0] = (blue + tissue_samples * pixel[0]) / SAMPLES_PER_PIXEL
    pixel[1] = (green + tissue_samples * pixel[1]) / SAMPLES_PER_PIXEL
    pixel[2] = (red + tissue_samples * pixel[2]) / SAMPLES_PER_PIXEL
