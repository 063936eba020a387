"""From frames to marker centres."""

from rcmservo.tracking.colours import COLOURS
from rcmservo.tracking.images import read_image, write_image
from rcmservo.tracking.markers import ColourMarkers, MarkerLook, PointMarkers

__all__ = ["COLOURS", "ColourMarkers", "MarkerLook", "PointMarkers", "read_image", "write_image"]
