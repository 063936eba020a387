"""The camera's picture with what the servo sees in it: the tool blue, the target black, as in Fig.
7."""

import itertools
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats, Image

BLUE, BLACK, WHITE, YELLOW = (255, 90, 0), (0, 0, 0), (255, 255, 255), (0, 220, 255)
SHIFT = 4
"""Bits of sub-pixel position in OpenCV's drawing."""

DARK = (45, 35, 30)
FONT = cv2.FONT_HERSHEY_SIMPLEX

FAR = 20_000.0
"""px. Of an imaged RCM further away than this only the direction is drawn."""


def draw(
    image: Image,
    points: Floats,
    o_c: Floats,
    target: Floats,
    words: str,
    others: Sequence[Floats] = (),
) -> Image:
    """A copy of the picture with the markers m₁ m₂ (2, 2), the imaged RCM o_c (2,), the target (2,
    2), all in px, and lines of words.

    The lines run from o_c to m₁ (r) and on to m₂ (d); their direction is s. What is NaN is left
    out. Further targets, `others`, are drawn in thin black.
    """
    picture = image.copy()
    for other in others:
        _tool(picture, other, o_c, BLACK, 1)
    _tool(picture, target, o_c, BLACK, 2)
    _tool(picture, points, o_c, BLUE, 2)
    if np.isfinite(o_c).all() and bool(np.max(np.abs(o_c)) < FAR):
        cv2.drawMarker(
            picture, (round(o_c[0]), round(o_c[1])), YELLOW, cv2.MARKER_TILTED_CROSS, 16, 2
        )
    height = image.shape[0]
    for row, line in enumerate(reversed(words.splitlines())):
        for colour, shift in ((BLACK, 1), (WHITE, 0)):
            place = 10 + shift, height - 12 - 20 * row + shift
            cv2.putText(picture, line, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return picture


class Ring(NamedTuple):
    """A ball of a picture, as it is drawn there."""

    u: float
    """px, of the centre."""
    v: float
    """px, of the centre."""
    radius: float
    """px."""
    words: str
    """Beside it."""
    strong: bool
    """Whether it is one of those that the picture is about."""


def draw_balls(image: Image, rings: Sequence[Ring], words: str) -> Image:
    """A copy of the picture with its balls ringed and named, those that are strong joined by a
    line, and a strip with words below it."""
    picture, size = image.copy(), max(image.shape[0] / 960.0, 0.45)
    strong = [ring for ring in rings if ring.strong]
    for a, b in itertools.pairwise(strong):
        for colour, width in ((DARK, 3), (YELLOW, 1)):
            ends = _fixed(np.array(a[:2])), _fixed(np.array(b[:2]))
            cv2.line(picture, ends[0], ends[1], colour, width, cv2.LINE_AA, SHIFT)
    for ring in sorted(rings, key=lambda ring: ring.strong):
        place, radius = _fixed(np.array(ring[:2])), round(ring.radius * (1 << SHIFT))
        for colour, width in ((DARK, 4), (YELLOW if ring.strong else WHITE, 2)):
            cv2.circle(picture, place, radius + (2 << SHIFT), colour, width, cv2.LINE_AA, SHIFT)
        if ring.strong:
            cv2.circle(picture, place, 2 << SHIFT, YELLOW, -1, cv2.LINE_AA, SHIFT)
    _labels(picture, rings, size)
    return np.vstack([picture, _strip(words, picture.shape[1], size)])


Box = tuple[int, int, int, int]
"""Left, top, right, bottom px."""


def _labels(picture: Image, rings: Sequence[Ring], size: float) -> None:
    """Words beside the rings, on the side away from the others, none upon another."""
    height, width = picture.shape[:2]
    middle = np.mean([ring.u for ring in rings]) if rings else 0.0
    boxes: list[Box] = []
    for ring in sorted(rings, key=lambda ring: -ring.strong):
        (long, high), _ = cv2.getTextSize(ring.words, FONT, size, 1)
        long, high = long + 12, high + 12
        right = ring.u >= middle
        left = ring.u + ring.radius + 8 if right else ring.u - ring.radius - 8 - long
        x = round(min(max(left, 0.0), width - long))
        y = round(min(max(ring.v - high / 2, 0.0), height - high))
        while y + high < height and any(_over((x, y, x + long, y + high), box) for box in boxes):
            y += 2
        boxes.append((x, y, x + long, y + high))
        colour = YELLOW if ring.strong else WHITE
        cv2.rectangle(picture, (x, y), (x + long, y + high), DARK, -1)
        cv2.rectangle(picture, (x, y), (x + long, y + high), colour, 1, cv2.LINE_AA)
        cv2.putText(picture, ring.words, (x + 6, y + high - 6), FONT, size, colour, 1, cv2.LINE_AA)


def _over(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _strip(words: str, width: int, size: float) -> Image:
    """Words on a dark strip as wide as the picture."""
    (long, high), _ = cv2.getTextSize(words or "n", FONT, size, 1)
    fit = int(0.95 * (width - 24) * len(words) / long)
    lines = textwrap.wrap(words, max(fit, 10)) or [""]
    step = round(1.9 * high)
    strip = np.full((step * len(lines) + high, width, 3), DARK, np.uint8)
    for row, line in enumerate(lines):
        place = 12, round(high * 0.5) + step * row + round(1.4 * high)
        cv2.putText(strip, line, place, FONT, size, WHITE, 1, cv2.LINE_AA)
    return strip


def _tool(
    picture: Image, points: Floats, o_c: Floats, colour: tuple[int, int, int], width: int
) -> None:
    if not np.isfinite(points).all():
        return
    path = [points[0], points[1]]
    if np.isfinite(o_c).all():
        away: Floats = o_c - points[0]
        path.insert(
            0, points[0] + away * min(1.0, FAR / 10.0 / max(float(np.linalg.norm(away)), 1.0))
        )
    for a, b in itertools.pairwise(path):
        cv2.line(picture, _fixed(a), _fixed(b), colour, width, cv2.LINE_AA, SHIFT)
    for point in points:
        cv2.circle(picture, _fixed(point), 8 << SHIFT, colour, width, cv2.LINE_AA, SHIFT)


def _fixed(point: Floats) -> tuple[int, int]:
    return round(float(point[0]) * (1 << SHIFT)), round(float(point[1]) * (1 << SHIFT))


def write_picture(path: Path, image: Image) -> None:
    """Write a picture to a file; its format is that of the file's name."""
    if not cv2.imwrite(str(path), image):
        raise UnusableFile(path, "cannot be written as a picture")
