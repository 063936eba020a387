"""Drawing on camera images: tool (blue) and target (black) as in Fig. 7, and rings around balls."""

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
SUBPIXEL_BITS = 4
"""Fractional bits of pixel positions in OpenCV's drawing functions."""

DARK = (45, 35, 30)
"""Colour of label backgrounds, blue-green-red."""

Colour = tuple[int, int, int]
"""Blue, green and red, 0 to 255."""

FONT = cv2.FONT_HERSHEY_SIMPLEX

MAX_POINT_DISTANCE_PX = 20_000.0
"""Largest coordinate (px) of an imaged RCM that is drawn as a point. Only the direction of a
farther one is drawn."""


def draw_overlay(
    image: Image,
    points: Floats,
    o_c: Floats,
    target: Floats,
    words: str,
    others: Sequence[Floats] = (),
) -> Image:
    """Return a copy of the image with the tool, the target and lines of text.

    Lines run from o_c to m1 (length r) and on to m2 (length d); their direction is s. NaN entries
    are left out.

    Parameters
    ----------
    image : array (height, width, 3)
        Camera image, uint8, blue-green-red.
    points : array (2, 2)
        Markers m1 and m2 (px), drawn in blue.
    o_c : array (2,)
        Imaged RCM (px), drawn as a cross.
    target : array (2, 2)
        Markers at the target (px), drawn in black.
    words : str
        Lines of text at the lower left.
    others : sequence of array (2, 2)
        Further targets (px), drawn in thin black.

    Returns
    -------
    array (height, width, 3)
        Annotated image.
    """
    result = image.copy()
    for other in others:
        _draw_tool(result, other, o_c, BLACK, 1)
    _draw_tool(result, target, o_c, BLACK, 2)
    _draw_tool(result, points, o_c, BLUE, 2)
    if np.isfinite(o_c).all() and bool(np.max(np.abs(o_c)) < MAX_POINT_DISTANCE_PX):
        cv2.drawMarker(
            result, (round(o_c[0]), round(o_c[1])), YELLOW, cv2.MARKER_TILTED_CROSS, 16, 2
        )
    height = image.shape[0]
    for row, line in enumerate(reversed(words.splitlines())):
        for colour, shift in ((BLACK, 1), (WHITE, 0)):
            position = 10 + shift, height - 12 - 20 * row + shift
            cv2.putText(result, line, position, FONT, 0.5, colour, 1, cv2.LINE_AA)
    return result


class BallRing(NamedTuple):
    """Circle with a label around a ball in an image.

    Parameters
    ----------
    u : float
        Column of the centre (px).
    v : float
        Row of the centre (px).
    radius : float
        Radius of the ball (px).
    label : str
        Label next to the ring.
    highlighted : bool
        True to highlight the ball.
    """

    u: float
    v: float
    radius: float
    label: str
    highlighted: bool


def draw_balls(image: Image, rings: Sequence[BallRing], words: str) -> Image:
    """Return a copy of the image with rings and labels around balls, and a caption below it.

    A line connects the highlighted balls.
    """
    result, size = image.copy(), max(image.shape[0] / 960.0, 0.45)
    marked = [ring for ring in rings if ring.highlighted]
    for a, b in itertools.pairwise(marked):
        for colour, width in ((DARK, 3), (YELLOW, 1)):
            ends = _to_subpixels(np.array(a[:2])), _to_subpixels(np.array(b[:2]))
            cv2.line(result, ends[0], ends[1], colour, width, cv2.LINE_AA, SUBPIXEL_BITS)
    for ring in sorted(rings, key=lambda ring: ring.highlighted):
        position, radius = _to_subpixels(np.array(ring[:2])), ring.radius + 2.0
        for colour, width in ((DARK, 4), (YELLOW if ring.highlighted else WHITE, 2)):
            _draw_circle(result, position, radius, colour, width)
        if ring.highlighted:
            _draw_circle(result, position, 2.0, YELLOW, -1)
    _draw_labels(result, rings, size)
    return np.vstack([result, _caption(words, result.shape[1], size)])


Box = tuple[int, int, int, int]
"""Left, top, right and bottom (px)."""


def _draw_labels(result: Image, rings: Sequence[BallRing], size: float) -> None:
    """Draw the labels of the rings, away from the other rings and without overlap."""
    height, width = result.shape[:2]
    centre_u = np.mean([ring.u for ring in rings]) if rings else 0.0
    boxes: list[Box] = []
    for ring in sorted(rings, key=lambda ring: -ring.highlighted):
        (label_width, label_height), _ = cv2.getTextSize(ring.label, FONT, size, 1)
        label_width, label_height = label_width + 12, label_height + 12
        right = ring.u >= centre_u
        left = ring.u + ring.radius + 8 if right else ring.u - ring.radius - 8 - label_width
        x = round(min(max(left, 0.0), width - label_width))
        y = round(min(max(ring.v - label_height / 2, 0.0), height - label_height))
        box = x, y, x + label_width, y + label_height
        while box[3] < height and any(_overlap(box, other) for other in boxes):
            box = x, box[1] + 2, box[2], box[3] + 2
        boxes.append(box)
        colour = YELLOW if ring.highlighted else WHITE
        cv2.rectangle(result, box[:2], box[2:], DARK, -1)
        cv2.rectangle(result, box[:2], box[2:], colour, 1, cv2.LINE_AA)
        start = x + 6, box[3] - 6
        cv2.putText(result, ring.label, start, FONT, size, colour, 1, cv2.LINE_AA)


def _overlap(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _caption(words: str, width: int, size: float) -> Image:
    """Return the words on a dark strip as wide as the image."""
    (label_width, label_height), _ = cv2.getTextSize(words or "n", FONT, size, 1)
    characters = int(0.95 * (width - 24) * len(words) / label_width)
    lines = textwrap.wrap(words, max(characters, 10)) or [""]
    line_height = round(1.9 * label_height)
    caption = np.full((line_height * len(lines) + label_height, width, 3), DARK, np.uint8)
    for row, line in enumerate(lines):
        position = 12, round(label_height * 0.5) + line_height * row + round(1.4 * label_height)
        cv2.putText(caption, line, position, FONT, size, WHITE, 1, cv2.LINE_AA)
    return caption


def _draw_tool(result: Image, points: Floats, o_c: Floats, colour: Colour, width: int) -> None:
    if not np.isfinite(points).all():
        return
    path = [points[0], points[1]]
    if np.isfinite(o_c).all():
        direction: Floats = o_c - points[0]
        length = max(float(np.linalg.norm(direction)), 1.0)
        path.insert(0, points[0] + direction * min(1.0, MAX_POINT_DISTANCE_PX / 10.0 / length))
    for a, b in itertools.pairwise(path):
        cv2.line(
            result, _to_subpixels(a), _to_subpixels(b), colour, width, cv2.LINE_AA, SUBPIXEL_BITS
        )
    for point in points:
        _draw_circle(result, _to_subpixels(point), 8.0, colour, width)


def _to_subpixels(point: Floats) -> tuple[int, int]:
    u, v = (round(float(x) * (1 << SUBPIXEL_BITS)) for x in point)
    return u, v


def _draw_circle(
    image: Image, subpixels: tuple[int, int], radius: float, colour: Colour, width: int
) -> None:
    """Draw a circle with a radius in px about a centre in subpixels."""
    scaled = round(radius * (1 << SUBPIXEL_BITS))
    cv2.circle(image, subpixels, scaled, colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def write_image(path: Path, image: Image) -> None:
    """Write an image to a file in the format of the file's suffix."""
    if not cv2.imwrite(str(path), image):
        raise UnusableFile(path, "cannot be written as an image")
