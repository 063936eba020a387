"""Periodic random fields, for the texture of tissue, the billows of smoke and the rim of blood."""

from collections.abc import Callable

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled


def make_random_field(
    random: np.random.Generator, size: int, amplitude: Callable[[Floats], Floats]
) -> Floats:
    """Return a periodic random field (size, size) with mean 0 and standard deviation 1.

    Parameters
    ----------
    random : numpy.random.Generator
        Generator of random numbers.
    size : int
        Number of nodes along a side.
    amplitude : callable
        Amplitude of a wave as a function of its number of periods across the field.
    """
    waves = np.hypot(np.fft.fftfreq(size, 1 / size)[:, None], np.fft.rfftfreq(size, 1 / size))
    spectrum = np.fft.rfft2(random.standard_normal((size, size))) * amplitude(waves)
    field = np.fft.irfft2(spectrum, s=(size, size))
    return (field - field.mean()) / field.std()


def sample_field(field: Floats, positions: Floats) -> Floats:
    """Interpolate a periodic field linearly at positions (row, column).

    Parameters
    ----------
    field : Floats, shape (rows, columns)
        Values at the nodes.
    positions : Floats, shape (2, ...)
        Positions in nodes.

    Returns
    -------
    Floats, shape (...)
        Values, NaN where a position is not finite.
    """
    values = np.empty(positions.shape[1:])
    interpolate_field(field, np.ascontiguousarray(positions).reshape(2, -1), values.reshape(-1))
    return values


@compiled
def interpolate_field(field: Floats, positions: Floats, values: Floats) -> None:
    """Fill `values` (n,) with a periodic field, interpolated linearly at `positions` (2, n)."""
    height, width = field.shape
    for k in range(len(values)):
        row, column = positions[0, k], positions[1, k]
        if not (np.isfinite(row) and np.isfinite(column)):
            values[k] = np.nan
            continue
        first_row, first_column = int(np.floor(row)), int(np.floor(column))
        down, right = row - first_row, column - first_column
        i, j = first_row % height, first_column % width
        next_i, next_j = (i + 1) % height, (j + 1) % width
        upper = (1.0 - right) * field[i, j] + right * field[i, next_j]
        lower = (1.0 - right) * field[next_i, j] + right * field[next_i, next_j]
        values[k] = (1.0 - down) * upper + down * lower
