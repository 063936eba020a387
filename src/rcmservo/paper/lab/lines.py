"""Lines of a tool that turns in the image about the imaged RCM, which is the origin."""

import numpy as np

from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.interfaces import Floats

REFINEMENTS = ImagedRcm().refinements
"""Steps of our own refinement."""


def markers(
    angles: Floats, r: float, d: float, noise: float, random: np.random.Generator
) -> Floats:
    """Return rows [u₁ v₁ u₂ v₂] px of a tool at these angles (n,) rad.

    Marker 1 is r px from the imaged RCM and marker 2 d px further, each coordinate with noise px.
    """
    n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    exact = np.concatenate([r * n, (r + d) * n], axis=1)
    return exact + noise * random.standard_normal(exact.shape)
