"""Strict reading and writing of image files: a truncated file is refused.

An image decoder fills the missing rest of an image with grey and reports no error. This module
therefore checks the end of the file.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Image

JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
JPEG_QUALITY = 95
PNG_START, PNG_LAST_CHUNK = b"\x89PNG\r\n\x1a\n", b"IEND"
JPEG_SIZE_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
"""JPEG markers that precede the height and width."""

MAX_FILE_BYTES, MAX_PIXELS = 256 << 20, 100_000_000
"""Limits of a file (bytes) and of an image. No camera's frame is larger, and a small file can
announce an image of gigabytes."""


def read_image(path: str | Path) -> Image:
    """Read a JPEG or PNG file.

    The image is not rotated, even if the file's metadata requests it.

    Parameters
    ----------
    path : str or Path
        Image file.

    Returns
    -------
    array (height, width, 3)
        Image, uint8, blue-green-red.

    Raises
    ------
    UnusableFile
        If the file cannot be read, is truncated or damaged, or is too large.
    """
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise UnusableFile(path, "is not a file")
        with Path(path).open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise UnusableFile(path, f"cannot be read ({error.strerror})") from error
    return decode_image(data, path)


def encode_image(image: Image) -> bytes:
    """Encode an image as a JPEG file at full colour resolution.

    Parameters
    ----------
    image : array (height, width, 3)
        Image, uint8, blue-green-red.

    Returns
    -------
    bytes
        Content of the file, with the JPEG quality 95.
    """
    import cv2

    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    flags = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, *sampling]
    return cv2.imencode(".jpg", image, flags)[1].tobytes()


def decode_image(data: bytes, name: str | Path) -> Image:
    """Decode the bytes of a JPEG or PNG file.

    Parameters
    ----------
    data : bytes
        Content of the file.
    name : str or Path
        Name of the file for error messages.

    Returns
    -------
    array (height, width, 3)
        Image, uint8, blue-green-red.

    Raises
    ------
    UnusableFile
        If the bytes are truncated, damaged or no image, or if the image is too large.
    """
    import cv2  # imported inside functions: commands without images start faster

    damage = _find_damage(data)
    if damage:
        raise UnusableFile(name, damage)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise UnusableFile(name, f"cannot be decoded ({error})") from error
    if image is None or image.dtype != np.uint8:
        raise UnusableFile(name, "is damaged, no picture can be decoded from it")
    return np.asarray(image, dtype=np.uint8)


def _find_damage(data: bytes) -> str:
    """Return the damage of an image file as a phrase; empty if it is whole."""
    if not data:
        return "is empty"
    if data.startswith(JPEG_START):
        # compressed data never holds the end marker, and some cameras pad with zeros after it
        is_whole = data.rstrip(b"\0").endswith(JPEG_END)
    elif data.startswith(PNG_START):
        is_whole = _has_whole_chunks(data)
    else:
        return "is neither a JPEG nor a PNG picture"
    if len(data) > MAX_FILE_BYTES or _read_announced_pixels(data) > MAX_PIXELS:
        return f"is larger than {MAX_PIXELS // 1_000_000} million pixels, too large for a frame"
    return "" if is_whole else "is cut off or damaged, a part of the picture is missing"


def _read_announced_pixels(data: bytes) -> int:
    """Return the number of pixels that the header of a JPEG or PNG file announces; 0 if unknown."""
    if data.startswith(PNG_START):
        width, height = struct.unpack_from(">II", data, 16) if len(data) >= 24 else (0, 0)
        return width * height
    position = 2
    while position + 9 <= len(data) and data[position] == 0xFF:
        if data[position + 1] in JPEG_SIZE_MARKERS:
            height, width = struct.unpack_from(">HH", data, position + 5)
            return height * width
        position += 2 + struct.unpack_from(">H", data, position + 2)[0]
    return 0


def _has_whole_chunks(data: bytes) -> bool:
    """Report whether every chunk (length, name, content, checksum) up to the last one is intact."""
    position = len(PNG_START)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        name, end = data[position + 4 : position + 8], position + 8 + length
        if data[end : end + 4] != struct.pack(">I", zlib.crc32(data[position + 4 : end])):
            return False
        if name == PNG_LAST_CHUNK:
            return True
        position = end + 4
    return False
