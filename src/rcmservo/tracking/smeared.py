"""A ball that moves while the picture is exposed: the mean of pictures along its way.

It is where the picture is most like a disc that is smeared so: a place that is good to a few px,
since the shaft hides a part of the ball. From there its outline tells more. Where the ball was for
half of the exposure, half of its colour is left, and that is so on its mean outline: along the way
the outline is a ramp as long as the way, symmetric about it; across, it stays sharp. So along each
ray the outermost place is taken where the colour is midway between its levels within the ramp and
beyond it.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.tracking.outline import COS, RAYS, SIN, mean, ray_profile, robust_ellipse

STEP = 0.5
"""px between the samples of a ray."""

BEYOND = (1.5, 4.0)
"""px beyond the ramp, from where to where the surroundings are measured."""

WITHIN = 0.8
"""Of the way from the ball's centre to the ramp: so far out its colour is measured."""

BORDER = 3.0
"""px of surroundings about the disc that the picture is compared with."""


class Like(NamedTuple):
    """Where a picture is most like a smeared disc."""

    u: int
    """px, of the centre."""
    v: int
    """px, of the centre."""
    likeness: float
    """Correlation of picture and disc there, at most 1."""
    disc: Floats
    """The disc's picture."""

    def contrast(self, weights: Floats) -> float:
        """What the picture shows more of the colour within the disc than about it."""
        rows, columns = self.disc.shape
        i, j = self.v - rows // 2, self.u - columns // 2
        there = weights[i : i + rows, j : j + columns]
        return self.likeness * float(there.std() / self.disc.std())


def most_like(weights: Floats, radius: float, smear: tuple[float, float]) -> Like | None:
    """Where the picture is most like a disc of this radius that moves by `smear` px; None where the
    picture is smaller than that."""
    import cv2

    disc = smeared_disc(radius, smear)
    height, width = disc.shape
    if weights.shape[0] < height or weights.shape[1] < width:
        return None
    both = weights.astype(np.float32), disc.astype(np.float32)
    like = cv2.matchTemplate(*both, cv2.TM_CCOEFF_NORMED)
    _, likeness, _, (u, v) = cv2.minMaxLoc(like)
    return Like(u + width // 2, v + height // 2, likeness, disc)


@compiled
def smeared_disc(radius: float, smear: tuple[float, float]) -> Floats:
    """A picture of the disc, 1 where it stayed for all of the exposure."""
    half = int(radius + 0.5 * max(abs(smear[0]), abs(smear[1])) + BORDER) + 1
    disc = np.zeros((2 * half + 1, 2 * half + 1))
    moments = max(round(np.hypot(smear[0], smear[1])), 1)
    for n in range(moments):
        along = (n + 0.5) / moments - 0.5
        u, v = half + along * smear[0], half + along * smear[1]
        for i in range(len(disc)):
            for j in range(len(disc)):
                within = radius + 0.5 - np.hypot(j - u, i - v)
                disc[i, j] += min(max(within, 0.0), 1.0) / moments
    return disc


@compiled
def smeared_outline(
    weights: Floats, start: tuple[float, float], radius: float, smear: tuple[float, float]
) -> tuple[Floats, Floats, float]:
    """As outline.fit_outline, of a ball with a known radius that moves by `smear` px meanwhile."""
    distance, fall = smeared_rays(weights, start, radius, smear)
    fit, spread = robust_ellipse(distance, radius)
    u, v = start[0] + fit[1], start[1] + fit[2]
    distance, fall = smeared_rays(weights, (u, v), radius, smear)
    fit, spread = robust_ellipse(distance, radius)
    rays = np.empty((2, RAYS))
    rays[0], rays[1] = distance - fit[1] * COS - fit[2] * SIN, fall
    return np.array([u + fit[1], v + fit[2], fit[0], fit[3], fit[4]]), rays, spread


@compiled
def smeared_rays(
    weights: Floats, start: tuple[float, float], radius: float, smear: tuple[float, float]
) -> tuple[Floats, Floats]:
    """The distance from `start` to the mean outline along each ray, NaN where there is none, and
    the colour's fall there."""
    longest = 1.5 * radius + 0.5 * np.hypot(smear[0], smear[1]) + BEYOND[1]
    profile = np.empty(int(longest / STEP) + 1)
    distance, fall = np.full(RAYS, np.nan), np.zeros(RAYS)
    for k in range(RAYS):
        n = ray_profile(weights, start, (STEP * COS[k], STEP * SIN[k]), profile)
        ramp = 0.5 * abs(smear[0] * COS[k] + smear[1] * SIN[k])
        core = max(int(WITHIN * (radius - ramp) / STEP), 3)
        first = int((radius + ramp + BEYOND[0]) / STEP)
        last = min(int((radius + ramp + BEYOND[1]) / STEP), n)
        if last - first >= 2:
            inside, outside = mean(profile, core // 2, core), mean(profile, first, last)
            distance[k] = STEP * outermost(profile[:last], 0.5 * (inside + outside))
            fall[k] = inside - outside
    return distance, fall


@compiled
def outermost(profile: Floats, level: float) -> float:
    """The outermost place, between samples, where the profile falls through a level; NaN if it
    never does."""
    for k in range(profile.size - 1, 0, -1):
        if profile[k] < level <= profile[k - 1]:
            return k - 1 + (profile[k - 1] - level) / (profile[k - 1] - profile[k])
    return np.nan
