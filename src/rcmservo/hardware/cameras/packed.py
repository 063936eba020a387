"""Pictures that come as image files, as JPEGs from a camera on the network or on a topic."""

from typing import Any, cast

import cv2
import numpy as np

from rcmservo.interfaces import Image

JPEG, JPEG_PIXELS, JPEG_END = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
"""Marks in a JPEG file: where it begins, where its pixels do, and its end."""
AS_STORED = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
"""In colours, and never turned."""


def unpacked(data: bytes) -> Image | None:
    """The picture in an image file, blue-green-red; None where it is damaged.

    What half a JPEG file lacks OpenCV 4.10 and 4.11 fill with the picture before; a whole one has
    its end mark behind its last pixels, and never among them. A JPEG has a colour for four pixels,
    which is spread smoothly over them here: FFmpeg repeats it, and small markers look torn.
    """
    cut = data[:2] == JPEG and data.rfind(JPEG_END) < data.rfind(JPEG_PIXELS)
    if cut or not data:
        return None
    return cast(Any, cv2.imdecode(np.frombuffer(data, np.uint8), AS_STORED))
