"""Damage to frames on their way from the camera.

Images travel as JPEG files here, as from inexpensive cameras. Bits of the file flip, or half of it
is missing, and a decoder makes an image of the rest without an error.
"""

import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np

from rcmservo.interfaces import Floats, Frame, Image

FLIPPED_BITS = 8
"""Bits that flip in a file."""

JPEG_END = np.array([0xFF, 0xD9], dtype=np.uint8)
"""End marker that a decoder expects after the last row. Missing rows before it become grey."""

INTACT_FRACTION = 0.05
"""Fraction at the start of a file that stays intact: a file damaged there cannot be decoded."""


def damage(frame: Frame, what: str, random: np.random.Generator) -> Frame:
    """Return a damaged copy of a frame.

    Parameters
    ----------
    frame : Frame
        Undamaged frame.
    what : {"size", "half", "noise", "none"}
        Another size, half missing, flipped bits, or an empty frame.
    random : numpy.random.Generator
        Generator of random numbers.
    """
    if frame.image is not None:
        return replace(frame, image=_damage_image(frame.image, what, random))
    if frame.points is not None:
        return replace(frame, points=_damage_points(frame.points, what, random))
    return frame


def _damage_image(image: Image, what: str, random: np.random.Generator) -> Image | None:
    if what == "none":
        return None
    if what == "size":
        return np.ascontiguousarray(image[::2, ::2])
    data = cv2.imencode(".jpg", image)[1].ravel()
    if what == "half":
        data = np.append(data[: len(data) // 2], JPEG_END)
    else:
        _flip_bits(data[round(INTACT_FRACTION * len(data)) :], random)
    with _suppress_stderr():
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return None if decoded is None else np.asarray(decoded, dtype=np.uint8)  # pyright: ignore[reportUnnecessaryComparison]


def _damage_points(points: Floats, what: str, random: np.random.Generator) -> Floats | None:
    if what == "none":
        return None
    if what == "size":
        return points[:1].copy()
    points = points.copy()
    if what == "half":
        points[1] = np.nan
    else:
        _flip_bits(points.view(np.uint8).ravel(), random)
    return points


def _flip_bits(data: Image, random: np.random.Generator) -> None:
    """Flip random bits of `data`, in place."""
    indices = random.integers(data.size, size=FLIPPED_BITS)
    data[indices] ^= (1 << random.integers(8, size=FLIPPED_BITS)).astype(np.uint8)


@contextmanager
def _suppress_stderr() -> Generator[None]:
    """Suppress the decoder's warnings, which it writes to the process's standard error."""
    sys.stderr.flush()
    saved = os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)
