"""One ball in a picture, and whether what was seen is a ball at all."""

from dataclasses import dataclass

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.tracking.outline import disc_centre, fit_outline

LEAST_RADIUS = 4.0
"""px. In a smaller ball, half a pixel of noise looks like roundness."""

LEAST_SUPPORT = 0.45
"""Of the outline. A shorter arc fixes the centre too badly."""

LEAST_FILLED = 0.35
"""Of the disc. The shaft hides less; what is emptier is a ring."""

LEAST_CONTRAST = 15.0
"""Grey levels. It must be four times the picture's noise too."""


@dataclass(frozen=True)
class Ball:
    """The silhouette of a whole ball, also where something hides a part of it."""

    u: float
    """px, of the centre."""

    v: float
    """px, of the centre."""

    radius: float
    """px."""

    quality: float
    """How well it was seen: above 0, at most 1."""

    def distance(self, other: "Ball") -> float:
        """From centre to centre."""
        return float(np.hypot(self.u - other.u, self.v - other.v))

    def within(self, width: int, height: int) -> bool:
        """Whether the picture shows the whole silhouette, a pixel of surroundings included."""
        margin = self.radius + 1.0
        return margin <= self.u <= width - 1 - margin and margin <= self.v <= height - 1 - margin


@compiled
def noise(weights: Floats) -> float:
    """The standard deviation of a weight, from the differences of neighbouring pixels."""
    stride = max(weights.size // 4000, 1)
    line = weights.ravel()
    return 1.05 * float(np.median(np.abs(line[1::stride] - line[:-1:stride])))


@compiled
def filled(weights: Floats, centre: tuple[float, float], radius: float, level: float) -> float:
    """The share of a disc's pixels that weigh more than `level`."""
    u, v = centre
    height, width = weights.shape
    full, count = 0, 0
    for i in range(max(int(v - radius), 0), min(int(v + radius) + 2, height)):
        for j in range(max(int(u - radius), 0), min(int(u + radius) + 2, width)):
            if (i - v) ** 2 + (j - u) ** 2 <= radius**2:
                count += 1
                full += weights[i, j] > level
    return full / max(count, 1)


def ball_near(weights: Floats, u: float, v: float, radius: float) -> Ball | None:
    """The ball whose place and radius are known to about a third of the radius."""
    u, v = disc_centre(weights, u, v, 1.2 * radius)
    return _judged(weights, fit_outline(weights, u, v, radius, 1.45 * radius), noise(weights))


def ball_about(weights: Floats, u: float, v: float, radius: float, grain: float) -> Ball | None:
    """The ball about a point inside it, its radius known to a factor of about 1.5.

    `grain` is the noise of the weights.
    """
    return _judged(weights, fit_outline(weights, u, v, radius, 1.8 * radius), grain)


def _judged(weights: Floats, outline: Floats, grain: float) -> Ball | None:
    """The outline as a ball with its quality, or None where it is no ball's."""
    u, v, radius, support, spread, contrast = (float(x) for x in outline)
    widest = 0.5 + 0.04 * radius
    good = radius >= LEAST_RADIUS and support >= LEAST_SUPPORT and spread <= widest
    if not (good and contrast >= max(LEAST_CONTRAST, 4.0 * grain)):
        return None
    if filled(weights, (u, v), radius, 0.3 * contrast) < LEAST_FILLED:
        return None
    clear = contrast / (contrast + LEAST_CONTRAST + 4.0 * grain)
    return Ball(u, v, radius, support * clear / (1.0 + (spread / widest) ** 2))
