"""Conversion of camera data to blue-green-red images: raw pixel formats and image files."""

import ctypes
from typing import Any, cast

import cv2
import numpy as np

from rcmservo.interfaces import Image

PIXEL_FORMATS: dict[int, tuple[str, int | None]] = {
    0x02180014: ("RGB8", cv2.COLOR_RGB2BGR),
    0x02180015: ("BGR8", None),
    0x01080009: ("BayerRG8", cv2.COLOR_BayerRGGB2BGR),
    0x01080008: ("BayerGR8", cv2.COLOR_BayerGRBG2BGR),
    0x0108000A: ("BayerGB8", cv2.COLOR_BayerGBRG2BGR),
    0x0108000B: ("BayerBG8", cv2.COLOR_BayerBGGR2BGR),
    0x01080001: ("Mono8", cv2.COLOR_GRAY2BGR),
}
"""Supported GenICam pixel formats in order of preference: name and OpenCV conversion by code."""

JPEG_START, JPEG_SCAN, JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
"""Markers of a JPEG file: start, begin of the pixel data, end."""
COLOUR_UNROTATED = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION


def decode_raw_image(code: int, width: int, height: int, address: int, size: int) -> Image | None:
    """Copy a raw image from memory as blue-green-red.

    Parameters
    ----------
    code : int
        GenICam pixel format.
    width, height : int
        Image size in px.
    address, size : int
        Buffer in memory, and its size in bytes.

    Returns
    -------
    ndarray, shape (height, width, 3), uint8, or None
        None if the format is not supported, or the buffer is too small.
    """
    if code not in PIXEL_FORMATS or min(width, height) < 1 or not address:
        return None
    name, conversion = PIXEL_FORMATS[code]
    shape = (height, width, 3) if name in ("RGB8", "BGR8") else (height, width)
    if int(np.prod(shape)) > size:
        return None
    content = (ctypes.c_uint8 * int(np.prod(shape))).from_address(address)
    raw = np.ctypeslib.as_array(content).reshape(shape)
    return raw.copy() if conversion is None else cast(Image, cv2.cvtColor(raw, conversion))


def decode_image_file(data: bytes) -> Image | None:
    """Decode the content of an image file as blue-green-red, None if it is damaged.

    OpenCV 4.10 and 4.11 fill the missing part of a truncated JPEG with the previous image. A
    complete JPEG has its end marker after the last pixels, and never among them. A JPEG stores one
    colour for four pixels, which OpenCV interpolates smoothly. FFmpeg repeats it, and small markers
    look torn.
    """
    truncated = data[:2] == JPEG_START and data.rfind(JPEG_END) < data.rfind(JPEG_SCAN)
    if truncated or not data:
        return None
    return cast(Any, cv2.imdecode(np.frombuffer(data, np.uint8), COLOUR_UNROTATED))
