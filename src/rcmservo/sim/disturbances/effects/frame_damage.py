"""Damaged frames: another size, half missing, flipped bits, or empty.

Images travel as JPEG files here, as from inexpensive cameras. The damage is done to the file: bits
flip, or its second half is missing. A decoder makes an image of the rest without an error.
"""

import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np

from rcmservo.interfaces import Floats, Frame, Image

FLIPPED_BIT_COUNT = 8
"""Number of bits that flip in a frame."""

JPEG_END_MARKER = np.array([0xFF, 0xD9], dtype=np.uint8)
"""Bytes that a decoder expects after the last row. Missing rows before them become grey."""

STDERR_DESCRIPTOR = 2
"""File descriptor of the process's standard error."""

INTACT_FRACTION = 0.05
"""Fraction at the start of a file that stays intact: a file damaged there cannot be decoded."""


def damage_frame(frame: Frame, what: str, random: np.random.Generator) -> Frame:
    """Return a damaged copy of a frame.

    Parameters
    ----------
    frame : Frame
        Undamaged frame.
    what : {"size", "half", "noise", "none"}
        Damage: another size, half missing, flipped bits, or an empty frame.
    random : numpy.random.Generator
        Generator of random numbers.
    """
    if frame.image is not None:
        return replace(frame, image=_damage_image(frame.image, what, random))
    if frame.points is not None:
        return replace(frame, points=_damage_points(frame.points, what, random))
    return frame


def _damage_image(image: Image, what: str, random: np.random.Generator) -> Image | None:
    """Return a damaged copy of an image (H, W, 3), None if nothing can be decoded."""
    if what == "none":
        return None
    if what == "size":
        return np.ascontiguousarray(image[::2, ::2])
    file_bytes = cv2.imencode(".jpg", image)[1].ravel()
    if what == "half":
        file_bytes = np.append(file_bytes[: len(file_bytes) // 2], JPEG_END_MARKER)
    else:
        _flip_bits(file_bytes[round(INTACT_FRACTION * len(file_bytes)) :], random)
    with _suppress_stderr():
        decoded = cv2.imdecode(file_bytes, cv2.IMREAD_COLOR)
    return None if decoded is None else np.asarray(decoded, dtype=np.uint8)  # pyright: ignore[reportUnnecessaryComparison]


def _damage_points(points: Floats, what: str, random: np.random.Generator) -> Floats | None:
    """Return damaged copies of the markers (2, 2) px of a camera without images."""
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
    """Flip random bits of the bytes `data`, in place."""
    byte_indices = random.integers(data.size, size=FLIPPED_BIT_COUNT)
    data[byte_indices] ^= (1 << random.integers(8, size=FLIPPED_BIT_COUNT)).astype(np.uint8)


@contextmanager
def _suppress_stderr() -> Generator[None]:
    """Suppress the decoder's warnings, which it writes to the process's standard error."""
    sys.stderr.flush()
    stderr_copy = os.dup(STDERR_DESCRIPTOR)
    try:
        with open(os.devnull, "wb") as null_file:
            os.dup2(null_file.fileno(), STDERR_DESCRIPTOR)
        yield
    finally:
        os.dup2(stderr_copy, STDERR_DESCRIPTOR)
        os.close(stderr_copy)
