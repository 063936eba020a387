"""One motion explained: Ĵ moved towards the nearest Jacobian with Ĵ Δp = Δy."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import product


@compiled
def toward(J: Floats, delta_p: Floats, delta_y: Floats, share: float) -> Floats:
    """J + share (Δy − J Δp) Δpᵀ/|Δp|² (3, 3); Δp (3,) mm must not be zero."""
    squared = delta_p[0] ** 2 + delta_p[1] ** 2 + delta_p[2] ** 2
    foretold, out = product(J, delta_p), np.empty(J.shape)
    for i in range(J.shape[0]):
        for j in range(J.shape[1]):
            out[i, j] = J[i, j] + share / squared * (delta_y[i] - foretold[i]) * delta_p[j]
    return out
