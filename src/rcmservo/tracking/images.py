"""Pictures in files, read strictly: a file that was cut off is refused, not half read.

A decoder fills the missing rest of a picture with grey and says nothing. So the end is checked
here.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Image

JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
QUALITY = 95
PNG_START, PNG_LAST = b"\x89PNG\r\n\x1a\n", b"IEND"
SIZES = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
"""The marks of a JPEG file behind which its height and width stand."""

LARGEST, MOST_PIXELS = 256 << 20, 100_000_000
"""Bytes of a file and pixels of a picture: no camera's frame is larger, and a small file can ask
for gigabytes."""


def read_image(path: str | Path) -> Image:
    """The picture (height, width, 3) in a JPEG or PNG file: uint8, blue-green-red.

    The picture is not turned, even if the file asks for it.
    """
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise UnusableFile(path, "is not a file")
        with Path(path).open("rb") as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise UnusableFile(path, f"cannot be read ({error.strerror})") from error
    return decode_image(data, path)


def encode_image(image: Image) -> bytes:
    """A picture as the bytes of a JPEG file, with its colour edges kept."""
    import cv2  # here, as in all of tracking: a command that shows no picture starts without it

    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY, *sampling])[1].tobytes()


def decode_image(data: bytes, name: str | Path) -> Image:
    """The picture in the bytes of a JPEG or PNG file that a person knows by its `name`."""
    flaw = _flaw(data)
    if flaw:
        raise UnusableFile(name, flaw)
    return _decoded(name, data)


def _flaw(data: bytes) -> str:
    """What is wrong with the bytes of a picture file; empty if they are whole."""
    if not data:
        return "is empty"
    if data.startswith(JPEG_START):
        # compressed data never holds the end marker, and some cameras pad with zeros after it
        whole = data.rstrip(b"\0").endswith(JPEG_END)
    elif data.startswith(PNG_START):
        whole = _png_chunks_whole(data)
    else:
        return "is neither a JPEG nor a PNG picture"
    if len(data) > LARGEST or _pixels(data) > MOST_PIXELS:
        return f"is larger than {MOST_PIXELS // 1_000_000} million pixels, too large for a frame"
    return "" if whole else "is cut off or damaged, a part of the picture is missing"


def _pixels(data: bytes) -> int:
    """How many pixels the head of a JPEG or PNG file announces; 0 where it tells nothing."""
    if data.startswith(PNG_START):
        width, height = struct.unpack_from(">II", data, 16) if len(data) >= 24 else (0, 0)
        return width * height
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        if data[place + 1] in SIZES:
            height, width = struct.unpack_from(">HH", data, place + 5)
            return height * width
        place += 2 + struct.unpack_from(">H", data, place + 2)[0]
    return 0


def _png_chunks_whole(data: bytes) -> bool:
    """Whether every chunk (length, name, content, checksum) agrees with its checksum.

    The last chunk must be there.
    """
    place = len(PNG_START)
    while place + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, place)
        name, end = data[place + 4 : place + 8], place + 8 + length
        if data[end : end + 4] != struct.pack(">I", zlib.crc32(data[place + 4 : end])):
            return False
        if name == PNG_LAST:
            return True
        place = end + 4
    return False


def _decoded(path: str | Path, data: bytes) -> Image:
    import cv2

    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise UnusableFile(path, f"cannot be decoded ({error})") from error
    if image is None or image.dtype != np.uint8:
        raise UnusableFile(path, "is damaged, no picture can be decoded from it")
    return np.asarray(image, dtype=np.uint8)
