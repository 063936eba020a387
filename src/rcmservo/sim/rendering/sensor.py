"""The sensor: light becomes grey levels, with noise."""

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled
from rcmservo.interfaces import Image
from rcmservo.sim.rendering.look import Look
from rcmservo.sim.rendering.vectors import Light

NORMALS = 1 << 21
"""Entries in the table of standard normal numbers."""


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
