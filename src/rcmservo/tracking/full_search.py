"""Search for balls of one colour in a whole image.

The search thresholds the colour response at several levels between the background and the strongest
response of the image, so that no level must suit every illumination. Each blob proposes a circle.
The outline fit accepts or rejects it.
"""

from collections.abc import Iterator

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.tracking.ball_fit import Ball, estimate_noise, fit_coarse_ball
from rcmservo.tracking.colours import halve_resolution

THRESHOLD_FRACTIONS = (0.65, 0.4, 0.22)
"""Thresholds, as fractions of the range from the background to the strongest response."""

MAX_BLOBS_PER_LEVEL = 8
"""Number of blobs examined per threshold, the largest first."""

MIN_BLOB_AREA_PX = 8
"""Smallest area of a blob (pixels at half resolution)."""


def find_balls(response: Floats) -> list[Ball]:
    """Return every ball that lies wholly in the image, best quality first."""
    height, width = response.shape
    noise = estimate_noise(response)
    found: list[Ball] = []
    for u, v, radius in _propose_circles(halve_resolution(response)):
        if any(np.hypot(u - b.u, v - b.v) < 0.7 * b.radius and b.quality > 0.5 for b in found):
            continue
        ball = fit_coarse_ball(response, u, v, radius, noise)
        if ball and ball.is_within(width, height):
            found = merge_ball(found, ball)
    return sorted(found, key=lambda ball: -ball.quality)


def merge_ball(found: list[Ball], ball: Ball) -> list[Ball]:
    """Return the list with one more ball; of two fits of the same ball the better one stays."""
    same = [other for other in found if other.is_same(ball)]
    if any(other.quality >= ball.quality for other in same):
        return found
    return [other for other in found if other not in same] + [ball]


def _propose_circles(coarse: Image) -> Iterator[tuple[float, float, float]]:
    """Yield circles (u, v, radius) of blobs in full-resolution pixels, highest threshold first."""
    import cv2

    if min(coarse.shape) < 4:
        return
    background, spread = _measure_background(coarse)
    strongest = float(np.max(cv2.blur(coarse, (3, 3))))
    for fraction in THRESHOLD_FRACTIONS:
        level = background + fraction * (strongest - background)
        if level > background + 2.0 * spread + 4.0:
            mask = (coarse > level).astype(np.uint8)
            for u, v, radius in _list_blobs(mask):
                yield 2.0 * u + 0.5, 2.0 * v + 0.5, 2.0 * radius


def _measure_background(coarse: Image) -> tuple[float, float]:
    """Return the median of the response, and the distance from it to the 84th percentile.

    The markers are small, so they do not affect this spread.
    """
    cumulative = np.cumsum(np.bincount(coarse.ravel(), minlength=256)) / coarse.size
    median = int(np.searchsorted(cumulative, 0.5))
    return float(median), float(int(np.searchsorted(cumulative, 0.84)) - median)


def _list_blobs(mask: Image) -> Iterator[tuple[float, float, float]]:
    """Yield a circle (u, v, radius) for each of the largest blobs and for the discs inside it.

    Two balls that touch make one blob.
    """
    import cv2

    _, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    for k in 1 + np.argsort(-areas, kind="stable")[:MAX_BLOBS_PER_LEVEL]:
        left, top, width, height, area = (int(stats[k, column]) for column in range(5))
        if area < MIN_BLOB_AREA_PX:
            return
        yield float(centres[k, 0]), float(centres[k, 1]), float(np.sqrt(area / np.pi))
        blob = labels[top : top + height, left : left + width] == k
        for u, v, radius in _find_largest_discs(np.pad(blob, 1).astype(np.uint8)):
            yield left + u - 1.0, top + v - 1.0, radius


def _find_largest_discs(blob: Image) -> Iterator[tuple[float, float, float]]:
    """Yield the two largest discs (u, v, radius) inside a blob that overlap little."""
    import cv2

    depth = cv2.distanceTransform(blob, cv2.DIST_L2, 3)
    for _ in range(2):
        _, radius, _, (u, v) = cv2.minMaxLoc(depth)
        if radius < 2.0:
            return
        yield float(u), float(v), float(radius)
        cv2.circle(depth, (u, v), int(1.5 * radius), 0.0, -1)
