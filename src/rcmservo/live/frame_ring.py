"""Camera frames passed between processes in a ring of shared memory.

The process of the camera publishes its frames in a `FrameRing`; others read them with a
`RingCamera`.
"""

import struct
from multiprocessing.context import BaseContext

import numpy as np

from rcmservo.constraints import between
from rcmservo.errors import BadInput
from rcmservo.interfaces import Frame
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.shared_ring import SharedRing
from rcmservo.loop.run_result import CameraStatistics

SLOTS = 8
"""Number of frames that a ring holds."""

MAX_SIDE_PX = 4096
CHANNELS = 3
"""Colours of a pixel: blue, green, red."""

FRAME_HEAD = struct.Struct("<qqq")
"""Number of a frame, exposure and arrival in ns, stored before its pixels."""


class FrameRing:
    """Newest frames of one camera. A process receives the ring when it is started, not later.

    Parameters
    ----------
    context : BaseContext
        Start method of the processes that share the ring.
    width, height : int
        Size of the images in px, 1 to 4096.

    Raises
    ------
    BadInput
        If the size is out of range.
    """

    def __init__(self, context: BaseContext, width: int, height: int) -> None:
        for name, value in (("width", width), ("height", height)):
            between(1, MAX_SIDE_PX, "a number of px").require(name, value)
        self.shape = height, width, CHANNELS
        self.entries = SharedRing(context, SLOTS, FRAME_HEAD.size + height * width * CHANNELS)

    def publish(self, frame: Frame) -> None:
        """Add a frame as the newest one.

        Raises
        ------
        BadInput
            If its image has another shape or type.
        """
        image = frame.image
        if image is None or image.shape != self.shape or image.dtype != np.uint8:
            shape = None if image is None else image.shape
            raise BadInput("frame.image", shape, f"an image of the shape {self.shape}")
        head = FRAME_HEAD.pack(frame.number, frame.exposure, frame.arrival)
        self.entries.put(head, np.ascontiguousarray(image).data.cast("B"))

    def read(self, number: int) -> Frame | None:
        """Return the frame in an entry of the ring; None if the entry is overwritten.

        A damaged frame has no image.
        """
        entry = self.entries.read(number)
        if entry is None:
            return None
        pixels = np.frombuffer(entry.data, np.uint8, offset=FRAME_HEAD.size)
        image = pixels.reshape(self.shape) if entry.is_sound else None
        return Frame(*FRAME_HEAD.unpack_from(entry.data), image=image)


class RingCamera:
    """Camera that offers the newest frame of a ring."""

    def __init__(self, ring: FrameRing) -> None:
        self._ring = ring
        self._entry_number = -1
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        newest = self._ring.entries.newest
        frame = self._ring.read(newest) if newest > self._entry_number else None
        if frame is not None:
            self._entry_number, self._frame = newest, frame
        return self._frame


class RecordingCamera:
    """Camera that copies each new frame to a ring as well.

    `latest` makes the copy, so the thread that calls it spends the time. A frame of another size is
    not copied.

    Parameters
    ----------
    camera : LabCamera
        Source of the frames.
    ring : FrameRing
        Destination of the copies.
    """

    def __init__(self, camera: LabCamera, ring: FrameRing) -> None:
        self._camera, self._ring = camera, ring
        self._newest: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self._camera.latest()
        if frame is not None and frame is not self._newest:
            self._newest = frame
            if frame.image is not None and frame.image.shape == self._ring.shape:
                self._ring.publish(frame)
        return frame

    def counts(self) -> CameraStatistics:
        """Return the counts of frames so far."""
        return self._camera.counts()

    def close(self) -> None:
        """Release the camera."""
        self._camera.close()
