"""Lines of an imaged tool that rotates about the imaged RCM, which is the origin."""

import numpy as np

from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.interfaces import Floats

REFINEMENTS = ImagedRcm().refinements
"""Steps of the built-in refinement of (16)."""


def markers(
    angles: Floats, r: float, d: float, noise: float, random: np.random.Generator
) -> Floats:
    """Return rows [u₁ v₁ u₂ v₂] (n, 4) in px of a tool at `angles` (n,) in rad.

    Marker 1 is r px from the imaged RCM and marker 2 another d px. Each coordinate has Gaussian
    noise with the standard deviation `noise` (px).
    """
    n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    exact = np.concatenate([r * n, (r + d) * n], axis=1)
    return exact + noise * random.standard_normal(exact.shape)
