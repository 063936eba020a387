"""What the servo sees of the world and does to it: frames, observations, commands, targets, and three Protocols.

Time is integer nanoseconds on the plant's clock. A pixel (0, 0) is the centre of the top left pixel, u right, v down.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure of a camera.

    A camera that makes pictures fills `image` ((height, width, 3) uint8, blue-green-red as in OpenCV); one that
    simulates only the markers fills `points` ((2, 2) px: m1 and m2, NaN where unseen). Times in ns:
    `exposure` is the middle of the exposure, `arrival` the moment at which the host had the frame.
    """

    number: int
    exposure: int
    arrival: int
    image: Image | None = None
    points: Floats | None = None


@dataclass(frozen=True, eq=False)
class Markers:
    """Where a tracker saw the two markers.

    `points` (2, 2) px: row 0 is m1 (nearer the RCM), row 1 is m2 (nearer the tip); NaN where lost, never a guess.
    `radius` (2,) px of the imaged marker; `quality` (2,) from 0 (lost) to 1.
    """

    points: Floats
    radius: Floats
    quality: Floats


class Tracker(Protocol):
    """Frames to marker centres. It may remember where the markers were; `reset` makes it forget."""

    def find(self, frame: Frame) -> Markers: ...

    def reset(self) -> None: ...
