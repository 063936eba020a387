"""Detection of the two markers in camera images."""

from rcmservo.tracking.appearance import MarkerLook
from rcmservo.tracking.colour_markers import ColourMarkers, PointMarkers
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.image_files import decode_image, encode_image, read_image

__all__ = [
    "COLOURS",
    "ColourMarkers",
    "MarkerLook",
    "PointMarkers",
    "decode_image",
    "encode_image",
    "read_image",
]
