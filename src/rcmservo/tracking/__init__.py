"""From frames to marker centres."""

from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.images import decode_image, encode_image, read_image
from rcmservo.tracking.look import MarkerLook
from rcmservo.tracking.markers import ColourMarkers, PointMarkers

__all__ = [
    "COLOURS",
    "ColourMarkers",
    "MarkerLook",
    "PointMarkers",
    "decode_image",
    "encode_image",
    "read_image",
]
