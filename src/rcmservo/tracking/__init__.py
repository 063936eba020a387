"""Detection of the two markers in camera images."""

from rcmservo.tracking.appearance import MarkerAppearance
from rcmservo.tracking.colour_markers import ColourMarkers, PointMarkers
from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.image_files import decode_image, encode_image, read_image

__all__ = [
    "COLOURS",
    "ColourMarkers",
    "MarkerAppearance",
    "PointMarkers",
    "decode_image",
    "encode_image",
    "read_image",
]
