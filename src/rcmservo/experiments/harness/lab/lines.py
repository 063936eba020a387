"""Lines of a tool that turns in the image about the imaged RCM, which is the origin."""

from dataclasses import dataclass

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.imaged_rcm import ImagedRcm

DEGREE = float(np.radians(1.0))
REFINEMENTS = ImagedRcm().refinements
"""Steps of our own refinement."""


@dataclass(frozen=True)
class Lines:
    """What is known of the tool's lines."""

    H: int = 50
    """How many there are."""
    span: float = 10.0 * DEGREE
    """rad of the image over which they are spread evenly."""
    r: float = 200.0
    """px from the imaged RCM to marker 1."""
    d: float = 60.0
    """px from marker 1 to marker 2."""
    noise: float = 0.3
    """px in every marker coordinate."""


def markers(lines: Lines, angles: Floats, random: np.random.Generator) -> Floats:
    """Rows [u₁ v₁ u₂ v₂] px of a tool seen at these angles (n,) rad, with noise."""
    n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    exact = np.concatenate([lines.r * n, (lines.r + lines.d) * n], axis=1)
    return exact + lines.noise * random.standard_normal(exact.shape)
