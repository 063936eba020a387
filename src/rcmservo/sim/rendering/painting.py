"""The capsules' colours, painted over the tissue.

A pixel inside an outline takes one sample. A pixel on an outline takes SAMPLES, at places and
moments spread over the pixel and the exposure: coverage is integrated over both.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats, Image
from rcmservo.sim.rendering.capsules import Capsules, capsule_in, hit, nearest, times
from rcmservo.sim.rendering.coverage import TILE, uniform
from rcmservo.sim.rendering.lighting import Lamp, shade
from rcmservo.sim.rendering.look import Light

SAMPLES = 32
"""On a pixel at an outline."""


class Shot(NamedTuple):
    """What one picture is painted from."""

    rays: Floats
    """(H, W, 6): for each pixel x, y of its ray, and dx/du, dy/du, dx/dv, dy/dv."""

    capsules: Capsules
    """The tool during the exposure."""

    lamp: Lamp
    """Where the light comes from."""

    pattern: Floats
    """(SAMPLES, 3): u, v px from the pixel's centre and the pose of each sample."""


def pattern_of(moments: int) -> Floats:
    """Where in the pixel and when each sample is taken, at so many moments: `Shot.pattern`.

    The places are a lattice without a favoured direction, symmetric about the pixel's centre: an
    outline of any direction is cut evenly. Opposite places share a moment, so each moment's samples
    have their mean at the centre, and blur shifts nothing.
    """
    i = np.arange(SAMPLES)
    u, v = (i + 0.5) / SAMPLES - 0.5, ((7 * i + 3) % SAMPLES + 0.5) / SAMPLES - 0.5
    pair = np.minimum(i, SAMPLES - 1 - i)
    turn = 5 * pair % (SAMPLES // 2)
    return np.stack([u, v, 1 + turn * moments // (SAMPLES // 2)], axis=1)


@compiled
def paint(canvas: Light, seen: Image, touched: Image, shot: Shot) -> None:
    """Paint the capsules over the tissue on the canvas (H, W, 3)."""
    rays = shot.rays
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            if touched[i, j] == 0:
                continue
            for y in range(i * TILE, min((i + 1) * TILE, rays.shape[0])):
                for x in range(j * TILE, min((j + 1) * TILE, rays.shape[1])):
                    if not uniform(seen, y, x):
                        paint_outline(canvas[y, x], rays[y, x], touched[i, j], shot)
                    elif seen[0, y, x] > 0:
                        paint_inside(canvas[y, x], rays[y, x], seen[0, y, x] - 1, shot)


@compiled
def paint_inside(pixel: Light, slopes: Floats, k: int, shot: Shot) -> None:
    """Give a `pixel` (3,) the light of capsule k at its centre."""
    ray = (slopes[0], slopes[1], 1.0)
    capsule = capsule_in(shot.capsules, 0, k)
    depth = hit(ray, capsule)
    if depth < np.inf:
        pixel[0], pixel[1], pixel[2] = shade(times(depth, ray), capsule, shot.lamp)


@compiled
def paint_outline(pixel: Light, ray: Floats, which: int, shot: Shot) -> None:
    """Replace a `pixel` (3,) of tissue by the mean of what its samples see."""
    blue, green, red, tissue = 0.0, 0.0, 0.0, 0
    for n in range(SAMPLES):
        u, v, pose = shot.pattern[n, 0], shot.pattern[n, 1], int(shot.pattern[n, 2])
        sample = (ray[0] + u * ray[2] + v * ray[4], ray[1] + u * ray[3] + v * ray[5], 1.0)
        k, depth = nearest(sample, shot.capsules, pose, which)
        if k < 0:
            tissue += 1
        else:
            light = shade(times(depth, sample), capsule_in(shot.capsules, pose, k), shot.lamp)
            blue, green, red = blue + light[0], green + light[1], red + light[2]
    pixel[0] = (blue + tissue * pixel[0]) / SAMPLES
    pixel[1] = (green + tissue * pixel[1]) / SAMPLES
    pixel[2] = (red + tissue * pixel[2]) / SAMPLES
