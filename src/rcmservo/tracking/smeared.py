"""The outline of a ball that moves while the picture is exposed.

A picture of it is the mean of pictures along its way. Where the ball was for half of the exposure,
half of its colour is left, and that is so on its mean outline: along the way the outline is a ramp
as long as the way, symmetric about it; across, it stays sharp. So along each ray the outermost
place is taken where the colour is midway between its levels within the ramp and beyond it.
"""

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
