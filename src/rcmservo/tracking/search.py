"""Balls of one colour anywhere in a picture.

Blobs are cut out at several levels between the picture's own background and its own strongest
colour, so that no level need be right for every light. Each blob proposes a place. The outline
decides whether a ball is there.
"""

from collections.abc import Iterator

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.tracking.ball import Ball, ball_about, noise
from rcmservo.tracking.colours import halved

LEVELS = (0.65, 0.4, 0.22)
"""Of the way from the background to the strongest colour."""

BLOBS = 8
"""At most so many for each level, the largest ones."""

LEAST_AREA = 8
"""Half-resolution pixels of a blob."""


def balls(weights: Floats) -> list[Ball]:
    """Every ball that lies wholly in the picture of these weights, best seen first."""
    height, width = weights.shape
    grain = noise(weights)
    found: list[Ball] = []
    for u, v, radius in _starts(halved(weights)):
        if any(np.hypot(u - b.u, v - b.v) < 0.7 * b.radius and b.quality > 0.5 for b in found):
            continue
        ball = ball_about(weights, u, v, radius, grain)
        if ball and ball.within(width, height):
            found = without_worse(found, ball)
    return sorted(found, key=lambda ball: -ball.quality)


def without_worse(found: list[Ball], ball: Ball) -> list[Ball]:
    """The list with one more ball, unless it is a worse view of one that is there."""
    same = [b for b in found if b.distance(ball) < 0.7 * max(b.radius, ball.radius)]
    if any(b.quality >= ball.quality for b in same):
        return found
    return [b for b in found if b not in same] + [ball]


def _starts(coarse: Image) -> Iterator[tuple[float, float, float]]:
    """Places (u, v, radius) of blobs in full-resolution pixels, the strongest colour first."""
    import cv2

    if min(coarse.shape) < 4:
        return
    background, spread = _background(coarse)
    strongest = float(np.max(cv2.blur(coarse, (3, 3))))
    for fraction in LEVELS:
        level = background + fraction * (strongest - background)
        if level > background + 2.0 * spread + 4.0:
            mask = (coarse > level).astype(np.uint8)
            for u, v, radius in _blobs(mask):
                yield 2.0 * u + 0.5, 2.0 * v + 0.5, 2.0 * radius


def _background(coarse: Image) -> tuple[float, float]:
    """The median of the picture, and how far above it the 84th percentile lies.

    That spread does not see the markers: they are small.
    """
    share = np.cumsum(np.bincount(coarse.ravel(), minlength=256)) / coarse.size
    median = int(np.searchsorted(share, 0.5))
    return float(median), float(int(np.searchsorted(share, 0.84)) - median)


def _blobs(mask: Image) -> Iterator[tuple[float, float, float]]:
    """The centre and radius of each of the largest blobs, and those of its widest parts.

    Two balls may touch and be one blob.
    """
    import cv2

    _, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    for k in 1 + np.argsort(-areas, kind="stable")[:BLOBS]:
        left, top, width, height, area = (int(stats[k, column]) for column in range(5))
        if area < LEAST_AREA:
            return
        yield float(centres[k, 0]), float(centres[k, 1]), float(np.sqrt(area / np.pi))
        part = labels[top : top + height, left : left + width] == k
        for u, v, radius in _widest(np.pad(part, 1).astype(np.uint8)):
            yield left + u - 1.0, top + v - 1.0, radius


def _widest(part: Image) -> Iterator[tuple[float, float, float]]:
    """The centres and radii of the two largest discs within a blob that do not overlap much."""
    import cv2

    depth = cv2.distanceTransform(part, cv2.DIST_L2, 3)
    for _ in range(2):
        _, radius, _, (u, v) = cv2.minMaxLoc(depth)
        if radius < 2.0:
            return
        yield float(u), float(v), float(radius)
        cv2.circle(depth, (u, v), int(1.5 * radius), 0.0, -1)
