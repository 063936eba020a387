"""Pictures in files, read strictly: a file that was cut off is refused, not half read.

A decoder fills the missing rest of a picture with grey and says nothing. So the end is checked
here.
"""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from rcmservo.errors import UnusableFile
from rcmservo.interfaces import Image

JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
JPEG = [
    cv2.IMWRITE_JPEG_QUALITY,
    95,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]
PNG_START, PNG_LAST = b"\x89PNG\r\n\x1a\n", b"IEND"


def read_image(path: str | Path) -> Image:
    """The picture (height, width, 3) in a JPEG or PNG file: uint8, blue-green-red.

    The picture is not turned, even if the file asks for it.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise UnusableFile(path, f"cannot be read ({error.strerror})") from error
    return decode_image(data, path)


def encode_image(image: Image) -> bytes:
    """A picture as the bytes of a JPEG file, with its colour edges kept."""
    return cv2.imencode(".jpg", image, JPEG)[1].tobytes()


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
    return "" if whole else "is cut off or damaged, a part of the picture is missing"


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
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise UnusableFile(path, f"cannot be decoded ({error})") from error
    if image is None or image.dtype != np.uint8:
        raise UnusableFile(path, "is damaged, no picture can be decoded from it")
    return np.asarray(image, dtype=np.uint8)
