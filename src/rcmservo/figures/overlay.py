"""Drawing on camera images: tool (blue) and target (black) as in Fig. 7, and rings around balls.

Balls are the round markers on the tool and what looks like them. The imaged RCM o_c is the point of
the image through which the imaged tool always passes.
"""

import itertools
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Floats, Image

Colour = tuple[int, int, int]
"""Blue, green and red, 0 to 255."""

BLUE, BLACK, WHITE, YELLOW = (255, 90, 0), (0, 0, 0), (255, 255, 255), (0, 220, 255)
DARK = (45, 35, 30)
"""Colour of label backgrounds."""

SUBPIXEL_BITS = 4
"""Fractional bits of pixel positions in OpenCV's drawing functions."""

FONT = cv2.FONT_HERSHEY_SIMPLEX

MAX_POINT_DISTANCE_PX = 20_000.0
"""Largest coordinate (px) of an imaged RCM that is drawn as a point. Of a farther one, only the
direction is drawn."""

Box = tuple[int, int, int, int]
"""Left, top, right and bottom (px)."""


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
        centre = round(o_c[0]), round(o_c[1])
        cv2.drawMarker(result, centre, YELLOW, cv2.MARKER_TILTED_CROSS, 16, 2)
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
    result, font_scale = image.copy(), max(image.shape[0] / 960.0, 0.45)
    highlighted_rings = [ring for ring in rings if ring.highlighted]
    for first, second in itertools.pairwise(highlighted_rings):
        for colour, width in ((DARK, 3), (YELLOW, 1)):
            _draw_line(result, np.array(first[:2]), np.array(second[:2]), colour, width)
    for ring in sorted(rings, key=lambda ring: ring.highlighted):
        centre, radius = np.array(ring[:2]), ring.radius + 2.0
        for colour, width in ((DARK, 4), (YELLOW if ring.highlighted else WHITE, 2)):
            _draw_circle(result, centre, radius, colour, width)
        if ring.highlighted:
            _draw_circle(result, centre, 2.0, YELLOW, -1)
    _draw_labels(result, rings, font_scale)
    return np.vstack([result, _draw_caption(words, result.shape[1], font_scale)])


def _draw_labels(result: Image, rings: Sequence[BallRing], font_scale: float) -> None:
    """Draw the labels of the rings, away from the other rings and without overlap."""
    height, width = result.shape[:2]
    centre_u = np.mean([ring.u for ring in rings]) if rings else 0.0
    boxes: list[Box] = []
    for ring in sorted(rings, key=lambda ring: -ring.highlighted):
        (text_width, text_height), _ = cv2.getTextSize(ring.label, FONT, font_scale, 1)
        label_width, label_height = text_width + 12, text_height + 12
        is_right_of_ring = ring.u >= centre_u
        gap = ring.radius + 8
        left = ring.u + gap if is_right_of_ring else ring.u - gap - label_width
        x = round(min(max(left, 0.0), width - label_width))
        y = round(min(max(ring.v - label_height / 2, 0.0), height - label_height))
        box = x, y, x + label_width, y + label_height
        while box[3] < height and any(_do_overlap(box, placed) for placed in boxes):
            box = x, box[1] + 2, box[2], box[3] + 2
        boxes.append(box)
        colour = YELLOW if ring.highlighted else WHITE
        cv2.rectangle(result, box[:2], box[2:], DARK, -1)
        cv2.rectangle(result, box[:2], box[2:], colour, 1, cv2.LINE_AA)
        text_start = x + 6, box[3] - 6
        cv2.putText(result, ring.label, text_start, FONT, font_scale, colour, 1, cv2.LINE_AA)


def _do_overlap(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _draw_caption(words: str, width: int, font_scale: float) -> Image:
    """Return the words on a dark strip as wide as the image."""
    (text_width, text_height), _ = cv2.getTextSize(words or "n", FONT, font_scale, 1)
    max_characters = int(0.95 * (width - 24) * len(words) / text_width)
    lines = textwrap.wrap(words, max(max_characters, 10)) or [""]
    line_height = round(1.9 * text_height)
    caption = np.full((line_height * len(lines) + text_height, width, 3), DARK, np.uint8)
    for row, line in enumerate(lines):
        position = 12, round(text_height * 0.5) + line_height * row + round(1.4 * text_height)
        cv2.putText(caption, line, position, FONT, font_scale, WHITE, 1, cv2.LINE_AA)
    return caption


def _draw_tool(result: Image, points: Floats, o_c: Floats, colour: Colour, width: int) -> None:
    """Draw the line from the imaged RCM through both markers, and a circle at each marker."""
    if not np.isfinite(points).all():
        return
    path = [points[0], points[1]]
    if np.isfinite(o_c).all():
        direction: Floats = o_c - points[0]
        length = max(float(np.linalg.norm(direction)), 1.0)
        path.insert(0, points[0] + direction * min(1.0, MAX_POINT_DISTANCE_PX / 10.0 / length))
    for start, end in itertools.pairwise(path):
        _draw_line(result, start, end, colour, width)
    for point in points:
        _draw_circle(result, point, 8.0, colour, width)


def _draw_line(image: Image, start: Floats, end: Floats, colour: Colour, width: int) -> None:
    """Draw a line between two points (2,) in px."""
    ends = _to_subpixels(start), _to_subpixels(end)
    cv2.line(image, *ends, colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_circle(image: Image, centre: Floats, radius: float, colour: Colour, width: int) -> None:
    """Draw a circle about a centre (2,); centre and radius are in px, a width of -1 fills it."""
    scaled_radius = round(radius * (1 << SUBPIXEL_BITS))
    subpixels = _to_subpixels(centre)
    cv2.circle(image, subpixels, scaled_radius, colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def _to_subpixels(point: Floats) -> tuple[int, int]:
    u, v = (round(float(x) * (1 << SUBPIXEL_BITS)) for x in point)
    return u, v


def write_image(path: Path, image: Image) -> None:
    """Write an image to a file in the format of the file's suffix."""
    if not cv2.imwrite(str(path), image):
        raise UnusableFile(path, "cannot be written as an image")
