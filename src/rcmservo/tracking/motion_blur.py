"""Fit of a ball that moves during the exposure: its image is the mean over its path.

A template match with a motion-blurred disc gives the centre to a few px, because the shaft hides a
part of the ball. The outline then gives it more precisely. On the mean outline the ball was present
for half of the exposure, so half of its colour remains. Along the motion the outline is a ramp as
long as the motion and symmetric about the mean outline; across the motion it stays sharp. On each
ray the fit uses the outermost point where the response is midway between its level inside the ramp
and its level outside.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.tracking.circle_fit import (
    RAY_COS,
    RAY_COUNT,
    RAY_SIN,
    fit_robust_ellipse,
    mean,
    sample_ray,
)

SAMPLE_STEP_PX = 0.5
"""Distance (px) between the samples of a ray."""

BACKGROUND_RANGE_PX = (1.5, 4.0)
"""Distances (px) outside the ramp between which the background is measured."""

CORE_FRACTION = 0.8
"""Fraction of the path from the ball's centre to the ramp up to which its colour is measured."""

TEMPLATE_BORDER_PX = 3.0
"""Width (px) of the background around the disc in the template."""


class TemplateMatch(NamedTuple):
    """Best match of a motion-blurred disc in an image.

    Parameters
    ----------
    u : int
        Column of the centre (px).
    v : int
        Row of the centre (px).
    correlation : float
        Correlation of image and template, at most 1.
    template : Floats
        Image of the blurred disc.
    """

    u: int
    v: int
    correlation: float
    template: Floats

    def measure_contrast(self, response: Floats) -> float:
        """Return the contrast between the disc and its surroundings in the image."""
        rows, columns = self.template.shape
        i, j = self.v - rows // 2, self.u - columns // 2
        window = response[i : i + rows, j : j + columns]
        return self.correlation * float(window.std() / self.template.std())


def match_blurred_disc(
    response: Floats, radius: float, motion: tuple[float, float]
) -> TemplateMatch | None:
    """Return the best match of a disc of this radius that moves by `motion` px.

    None if the image is smaller than the template.
    """
    import cv2

    template = render_blurred_disc(radius, motion)
    height, width = template.shape
    if response.shape[0] < height or response.shape[1] < width:
        return None
    arrays = response.astype(np.float32), template.astype(np.float32)
    correlations = cv2.matchTemplate(*arrays, cv2.TM_CCOEFF_NORMED)
    _, correlation, _, (u, v) = cv2.minMaxLoc(correlations)
    return TemplateMatch(u + width // 2, v + height // 2, correlation, template)


@compiled
def render_blurred_disc(radius: float, motion: tuple[float, float]) -> Floats:
    """Return the image of the blurred disc: 1 where the disc stays during the whole exposure."""
    half = int(radius + 0.5 * max(abs(motion[0]), abs(motion[1])) + TEMPLATE_BORDER_PX) + 1
    template = np.zeros((2 * half + 1, 2 * half + 1))
    positions = max(round(np.hypot(motion[0], motion[1])), 1)
    for n in range(positions):
        along = (n + 0.5) / positions - 0.5
        u, v = half + along * motion[0], half + along * motion[1]
        for i in range(len(template)):
            for j in range(len(template)):
                depth = radius + 0.5 - np.hypot(j - u, i - v)
                template[i, j] += min(max(depth, 0.0), 1.0) / positions
    return template


@compiled
def fit_blurred_outline(
    response: Floats, start: tuple[float, float], radius: float, motion: tuple[float, float]
) -> tuple[Floats, Floats, float]:
    """Fit the outline of a ball of known radius that moves by `motion` px during the exposure.

    Returns the ellipse, rays and spread of `circle_fit.fit_outline`.
    """
    distances, drop = cast_blurred_rays(response, start, radius, motion)
    fit, spread = fit_robust_ellipse(distances, radius)
    u, v = start[0] + fit[1], start[1] + fit[2]
    distances, drop = cast_blurred_rays(response, (u, v), radius, motion)
    fit, spread = fit_robust_ellipse(distances, radius)
    rays = np.empty((2, RAY_COUNT))
    rays[0], rays[1] = distances - fit[1] * RAY_COS - fit[2] * RAY_SIN, drop
    return np.array([u + fit[1], v + fit[2], fit[0], fit[3], fit[4]]), rays, spread


@compiled
def cast_blurred_rays(
    response: Floats, start: tuple[float, float], radius: float, motion: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Return the distance from `start` to the mean outline along each ray, and the response drop.

    The distance is NaN where no outline is found.
    """
    length = 1.5 * radius + 0.5 * np.hypot(motion[0], motion[1]) + BACKGROUND_RANGE_PX[1]
    profile = np.empty(int(length / SAMPLE_STEP_PX) + 1)
    distances, drop = np.full(RAY_COUNT, np.nan), np.zeros(RAY_COUNT)
    for k in range(RAY_COUNT):
        n = sample_ray(
            response, start, (SAMPLE_STEP_PX * RAY_COS[k], SAMPLE_STEP_PX * RAY_SIN[k]), profile
        )
        ramp = 0.5 * abs(motion[0] * RAY_COS[k] + motion[1] * RAY_SIN[k])
        core = max(int(CORE_FRACTION * (radius - ramp) / SAMPLE_STEP_PX), 3)
        first = int((radius + ramp + BACKGROUND_RANGE_PX[0]) / SAMPLE_STEP_PX)
        last = min(int((radius + ramp + BACKGROUND_RANGE_PX[1]) / SAMPLE_STEP_PX), n)
        if last - first >= 2:
            inside, outside = mean(profile, core // 2, core), mean(profile, first, last)
            distances[k] = SAMPLE_STEP_PX * locate_outermost_crossing(
                profile[:last], 0.5 * (inside + outside)
            )
            drop[k] = inside - outside
    return distances, drop


@compiled
def locate_outermost_crossing(profile: Floats, level: float) -> float:
    """Return the outermost position, between samples, where the profile falls through `level`.

    NaN if it never does.
    """
    for k in range(profile.size - 1, 0, -1):
        if profile[k] < level <= profile[k - 1]:
            return k - 1 + (profile[k - 1] - level) / (profile[k - 1] - profile[k])
    return np.nan
