"""One ball in a picture, and whether what was seen is a ball at all."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats, Image
from rcmservo.tracking.colours import MIXES, weights
from rcmservo.tracking.outline import (
    COS,
    RAYS,
    SIN,
    agreed,
    disc_centre,
    fit_outline,
    supported,
)
from rcmservo.tracking.rim import fit_rim
from rcmservo.tracking.smeared import most_like, smeared_disc, smeared_outline

LEAST_RADIUS = 4.0
"""px. In a smaller ball, half a pixel of noise looks like roundness."""

LEAST_SUPPORT = 0.45
"""Of the outline. A shorter arc fixes the centre too badly."""

LEAST_SEEKING = 0.3
"""Of the outline, about the coarse ellipse. Shading shifts it on large balls."""

NEARLY = 0.9
"""Of the coarse ellipse's support. The fitted one stands if it has so much: pixels that are smeared
by motion, or that show no shaded ball, lead it astray,"""
SURE = 0.04
"""or if its place has no more than this standard deviation, px: by pixels that lead it astray it
has twice as much, and a coarse one may have its support of the shaft's edges."""

LEAST_DEPTH = 0.3
"""Of the radius. A ball's colour reaches so far in from DEEP of the rays at least, also where the
shaft leaves a crescent of it; a ring's does not."""

DEEP = 6
"""Rays."""

STEPS = 32
"""Along a ray from the centre to the outline."""

ENOUGH = 1000
"""Pixels at least, whose neighbours tell a picture's noise to a twentieth."""

LEAST_CONTRAST = 15.0
"""Grey levels. It must be four times the picture's noise too."""

LEAST_LIKENESS = 0.75
"""Of a smeared ball with a smeared disc: the shaft and shading take up to a fifth from 1."""

FARTHEST = 5.0
"""px from where a smeared ball looks most like one to the centre of its outline."""

ROUGH = 2.0
"""px, standard deviation of the former,"""
SMEARED = 0.08
"""and of the latter, of the way: shading and the shaft shift the ramp that the outline is then."""


@dataclass(frozen=True, eq=False)
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

    covariance: Floats = field(default_factory=lambda: np.full((3, 3), np.nan))
    """(3, 3) px², of the noise in u, v and radius. NaN where only the place was asked for."""

    support: float = 0.0
    """Share of the outline that was seen."""

    @property
    def fixed(self) -> bool:
        """Whether enough of the outline was seen to fix the centre."""
        return self.support >= LEAST_SUPPORT

    def moved(self, du: float, dv: float) -> "Ball":
        """The same ball elsewhere."""
        return replace(self, u=self.u + du, v=self.v + dv)

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
    stride = max(weights.size // ENOUGH, 1)
    line = weights.ravel()
    return 1.05 * float(np.median(np.abs(line[1::stride] - line[:-1:stride])))


@compiled
def full(weights: Floats, ellipse: Floats, level: float) -> bool:
    """Whether more than `level` weighs for LEAST_DEPTH of the way from the centre out, on DEEP of
    the rays at least."""
    deep = 0
    for k in range(RAYS):
        count = 0
        for n in range(STEPS):
            way = ellipse[2] * (n + 0.5) / STEPS
            i, j = round(ellipse[1] + way * SIN[k]), round(ellipse[0] + way * COS[k])
            if 0 <= i < weights.shape[0] and 0 <= j < weights.shape[1]:
                count += weights[i, j] > level
        deep += count >= LEAST_DEPTH * STEPS
        if deep == DEEP:
            return True
    return False


def ball_near(image: Image, colour: int, u: float, v: float, radius: float) -> Ball | None:
    """The ball in a piece of a picture whose place and radius are known to about a third of the
    radius, as exactly as the pixels tell.

    Where the shaft hides one side, what is seen of the ball may lie too far beside its centre to
    begin from.
    """
    amounts = weights(image, colour)
    grain = noise(amounts)
    for start in (disc_centre(amounts, u, v, 1.2 * radius), (u, v)):
        ellipse, rays, spread = fit_outline(amounts, start, radius, 1.45 * radius)
        marks = (*supported(rays, ellipse, ellipse), spread)
        if _judged(amounts, ellipse, marks, grain):
            break
    else:
        return None
    fine, covariance = fit_rim(image, MIXES[colour], ellipse, agreed(rays, ellipse))
    sure = max(covariance[0, 0], covariance[1, 1]) <= SURE**2
    if not (sure or supported(rays, ellipse, fine)[0] >= NEARLY * marks[0]):
        fine, covariance = ellipse, spread**2 * np.eye(3)
    marks = (*supported(rays, ellipse, fine), spread)
    ball = _judged(amounts, fine, marks, grain)
    return replace(ball, covariance=covariance) if ball and ball.fixed else None


def smeared_ball(image: Image, colour: int, last: Ball, smear: tuple[float, float]) -> Ball | None:
    """As ball_near, of a ball that moves by `smear` px during the exposure: by its outline, or
    where that is lost, only where the picture is most like it."""
    amounts = weights(image, colour)
    like, grain = most_like(amounts, last.radius, smear), noise(amounts)
    if like is None or like.likeness < LEAST_LIKENESS:
        return None
    ellipse, rays, spread = smeared_outline(amounts, (like.u, like.v), last.radius, smear)
    marks = (*supported(rays, ellipse, ellipse), spread)
    ball = _judged(amounts, ellipse, marks, grain)
    if ball and ball.fixed and np.hypot(ball.u - like.u, ball.v - like.v) < FARTHEST:
        wrong = spread**2 + SMEARED**2 * (smear[0] ** 2 + smear[1] ** 2)
        return replace(ball, covariance=wrong * np.eye(3))
    if like.contrast(amounts) < max(LEAST_CONTRAST, 4.0 * grain):
        return None
    return Ball(like.u, like.v, last.radius, 0.5 * like.likeness, ROUGH**2 * np.eye(3))


@cache
def prepare_smeared() -> None:
    """Compile and load what a smeared ball needs: in mid-run that would hold up everything."""
    radius, way = 2.0 * LEAST_RADIUS, (LEAST_RADIUS, 0.0)
    disc = np.pad(smeared_disc(radius, way), int(radius))
    picture = np.zeros((*disc.shape, 3), dtype=np.uint8)
    picture[..., 2] = np.rint(200.0 * disc)
    middle = float(len(disc) // 2)
    assert smeared_ball(picture, 0, Ball(middle, middle, radius, 1.0), way)


def ball_about(weights: Floats, u: float, v: float, radius: float, grain: float) -> Ball | None:
    """The place of a ball about a point inside it, its radius known to a factor of about 1.5.

    `grain` is the noise of the weights.
    """
    first = fit_outline(weights, (u, v), radius, 1.8 * radius)[0]
    start = (float(first[0]), float(first[1]))
    ellipse, rays, spread = fit_outline(weights, start, float(first[2]), 1.45 * float(first[2]))
    return _judged(weights, ellipse, (*supported(rays, ellipse, ellipse), spread), grain)


def _judged(
    weights: Floats, ellipse: Floats, marks: tuple[float, float, float], grain: float
) -> Ball | None:
    """The outline as a ball with its quality, or None where it is no ball's.

    The `marks` are its support, contrast and spread.
    """
    u, v, radius = (float(x) for x in ellipse[:3])
    support, contrast, spread = marks
    widest = 0.5 + 0.04 * radius
    good = radius >= LEAST_RADIUS and support >= LEAST_SEEKING and spread <= widest
    if not (good and contrast >= max(LEAST_CONTRAST, 4.0 * grain)):
        return None
    if not full(weights, ellipse, 0.3 * contrast):
        return None
    clear = contrast / (contrast + LEAST_CONTRAST + 4.0 * grain)
    quality = support * clear / (1.0 + (spread / widest) ** 2)
    return Ball(u, v, radius, quality, support=support)
