"""Frames as they are after something has damaged them on the way.

A picture travels as a JPEG file here, as cheap cameras send it. Bits of the file flip, or half of
it is missing, and a decoder makes a picture of that without complaint.
"""

import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np

from rcmservo.interfaces import Floats, Frame, Image

FLIPS = 8
"""Bits that flip in a file."""

END = np.array([0xFF, 0xD9], dtype=np.uint8)
"""What a decoder looks for after the last row. Rows that are missing before it become grey."""

HEADER = 0.05
"""The share of a file, at its beginning, that stays whole. Damage there leaves nothing to
decode."""


def damaged(frame: Frame, what: str, random: np.random.Generator) -> Frame:
    """The frame, damaged.

    `what` is "size" (it has another one), "half" (that is missing), "noise" (bits flip) or "none"
    (nothing is left).
    """
    if frame.image is not None:
        return replace(frame, image=_picture(frame.image, what, random))
    if frame.points is not None:
        return replace(frame, points=_points(frame.points, what, random))
    return frame


def _picture(image: Image, what: str, random: np.random.Generator) -> Image | None:
    if what == "none":
        return None
    if what == "size":
        return np.ascontiguousarray(image[::2, ::2])
    file = cv2.imencode(".jpg", image)[1].ravel()
    if what == "half":
        file = np.append(file[: len(file) // 2], END)
    else:
        _flip(file[round(HEADER * len(file)) :], random)
    with _no_warnings():
        decoded = cv2.imdecode(file, cv2.IMREAD_COLOR)
    return None if decoded is None else np.asarray(decoded, dtype=np.uint8)  # pyright: ignore[reportUnnecessaryComparison]


def _points(points: Floats, what: str, random: np.random.Generator) -> Floats | None:
    if what == "none":
        return None
    if what == "size":
        return points[:1].copy()
    points = points.copy()
    if what == "half":
        points[1] = np.nan
    else:
        _flip(points.view(np.uint8).ravel(), random)
    return points


def _flip(data: Image, random: np.random.Generator) -> None:
    """Flip bits of these bytes, in place."""
    places = random.integers(data.size, size=FLIPS)
    data[places] ^= (1 << random.integers(8, size=FLIPS)).astype(np.uint8)


@contextmanager
def _no_warnings() -> Generator[None]:
    """Keep the decoder's warnings from the terminal. It writes them to the process's standard
    error."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
