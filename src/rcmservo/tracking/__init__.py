"""Detection of the two markers in camera images.

Each file answers one question:

- appearance: which colours and sizes do the markers have?
- colour_markers: where are the markers in this frame? `ColourMarkers` searches images,
  `PointMarkers` takes the points of a camera that delivers no images.
- marker_identity: which ball is marker 1 and which is marker 2?
- local_search, full_search: is there a ball near the expected position, or anywhere in the image?
- ball_fit: is this shape a ball, and where exactly is it?
- circle_fit, edge_fit, shading, motion_blur: which outline fits the pixels of a sharp, a shaded or
  a blurred ball?
- colours: how strongly does a pixel show a marker's colour?
- candidates: which balls of an image could an operator choose as markers?
- not_found: why are the markers not found?
- image_files: is an image file whole, and which image does it hold?
"""

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
