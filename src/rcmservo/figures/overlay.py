"""The camera's picture with what the servo sees in it: the tool blue, the target black, as in Fig.
7."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats, Image

BLUE, BLACK, WHITE, YELLOW = (255, 90, 0), (0, 0, 0), (255, 255, 255), (0, 220, 255)
SHIFT = 4
"""Bits of sub-pixel position in OpenCV's drawing."""

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


def _tool(
    picture: Image, points: Floats, o_c: Floats, colour: tuple[int, int, int], width: int
) -> None:
    if not np.isfinite(points).all():
        return
    path = [points[0], points[1]]
    if np.isfinite(o_c).all():
        away = o_c - points[0]
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
