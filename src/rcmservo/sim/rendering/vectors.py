"""Vectors in kernels: three numbers each."""

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled

Vector = tuple[float, float, float]

Light = NDArray[np.float32]
"""Light (H, W, 3) in grey levels, or a share of it (H, W)."""


@compiled
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def times(s: float, a: Vector) -> Vector:
    return s * a[0], s * a[1], s * a[2]


@compiled
def clip(share: float) -> float:
    """The share, brought between 0 and 1."""
    return min(max(share, 0.0), 1.0)
