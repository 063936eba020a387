"""Detection of the two markers in camera images.

The markers are coloured balls on the shaft. The public names are:

- `ColourMarkers`: tracker that searches images, and follows the balls from frame to frame.
- `PointMarkers`: tracker for a camera that delivers the markers' centres instead of images.
- `MarkerAppearance`: colours and radii of the two balls.
- `COLOURS`: names of the possible colours.
- `read_image`, `decode_image`: image from a JPEG or PNG file, or from its bytes; a truncated one is
  refused.
- `encode_image`: bytes of a JPEG file from an image.

For example, a green marker 1 and a blue marker 2, the default, with ``rs`` the package `rcmservo`.
On hardware, arm, camera and clock are those of the device drivers instead::

    rig = rs.sim.Rig(seed=0)
    look = rs.tracking.MarkerAppearance(colour_1="green", colour_2="blue")
    plant = rs.Plant(rig.arm, rig.camera, rs.tracking.ColourMarkers(look), rig.clock)
    markers = plant.tracker.find(rig.camera.latest())
    print(markers.points)    # centres (2, 2) in px

The method of detection is this project's own. In rendered images the root mean square error of a
centre is 0.015 px over 289 positions, and 0.047 px along paths of 5 mm with the default rig. At a
motion of 15 px per frame 0.3 % of the markers are lost or have an error above 8 px. These figures
are those of docs/results.md; ``python benchmarks/tracking.py 150`` repeats the measurement.

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
