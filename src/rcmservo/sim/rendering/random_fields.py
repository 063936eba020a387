"""Random fields that repeat: the mottle of tissue, the billows of smoke, the rim of blood."""

from collections.abc import Callable

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats


def random_field(
    random: np.random.Generator, size: int, strength: Callable[[Floats], Floats]
) -> Floats:
    """A random field (size, size) that repeats: mean 0, spread 1.

    `strength` tells that of waves by how often they fit into the field's width.
    """
    waves = np.hypot(np.fft.fftfreq(size, 1 / size)[:, None], np.fft.rfftfreq(size, 1 / size))
    spectrum = np.fft.rfft2(random.standard_normal((size, size))) * strength(waves)
    field = np.fft.irfft2(spectrum, s=(size, size))
    return (field - field.mean()) / field.std()


def sampled(field: Floats, places: Floats) -> Floats:
    """A field that repeats, at `places` (2, ...) in its own rows and columns, linear between them.

    NaN where a place is not known.
    """
    values = np.empty(places.shape[1:])
    read_field(field, np.ascontiguousarray(places).reshape(2, -1), values.reshape(-1))
    return values


@compiled
def read_field(field: Floats, places: Floats, values: Floats) -> None:
    """Fill `values` (n,) with a field that repeats, at `places` (2, n)."""
    height, width = field.shape
    for k in range(len(values)):
        row, column = places[0, k], places[1, k]
        if not (np.isfinite(row) and np.isfinite(column)):
            values[k] = np.nan
            continue
        above, before = int(np.floor(row)), int(np.floor(column))
        down, right = row - above, column - before
        i, j = above % height, before % width
        below, after = (i + 1) % height, (j + 1) % width
        upper = (1.0 - right) * field[i, j] + right * field[i, after]
        lower = (1.0 - right) * field[below, j] + right * field[below, after]
        values[k] = (1.0 - down) * upper + down * lower
