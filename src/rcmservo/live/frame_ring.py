"""Camera frames passed between processes in a ring of shared memory."""

import struct
from multiprocessing.context import BaseContext

import numpy as np

from rcmservo.constraints import between
from rcmservo.errors import require
from rcmservo.interfaces import Frame
from rcmservo.live.device_protocols import LabCamera
from rcmservo.live.shared_ring import SharedRing
from rcmservo.loop.run_result import CameraStatistics

SLOTS = 8
"""Number of frames that a ring holds."""

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
    """

    def __init__(self, context: BaseContext, width: int, height: int) -> None:
        for name, value in (("width", width), ("height", height)):
            between(1, 4096, "a number of px").require(name, value)
        self.shape = height, width, 3
        self.entries = SharedRing(context, SLOTS, FRAME_HEAD.size + height * width * 3)

    def publish(self, frame: Frame) -> None:
        """Add a frame as the newest one.

        Raises
        ------
        BadInput
            If its image has another shape or type.
        """
        image = frame.image
        fits = image is not None and image.shape == self.shape and image.dtype == np.uint8
        require(
            fits,
            "frame.image",
            None if image is None else image.shape,
            f"an image of the shape {self.shape}",
        )
        assert image is not None
        head = FRAME_HEAD.pack(frame.number, frame.exposure, frame.arrival)
        self.entries.put(head, np.ascontiguousarray(image).data.cast("B"))

    def read(self, entry: int) -> Frame | None:
        """Return the frame of an entry, None if it is overwritten; a damaged one has no image."""
        found = self.entries.read(entry)
        if found is None:
            return None
        pixels = np.frombuffer(found.data, np.uint8, offset=FRAME_HEAD.size)
        image = pixels.reshape(self.shape) if found.is_sound else None
        return Frame(*FRAME_HEAD.unpack_from(found.data), image=image)


class RingCamera:
    """Camera that offers the newest frame of a ring."""

    def __init__(self, ring: FrameRing) -> None:
        self._ring = ring
        self._entry = -1
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        newest = self._ring.entries.newest
        frame = self._ring.read(newest) if newest > self._entry else None
        if frame is not None:
            self._entry, self._frame = newest, frame
        return self._frame


class RecordingCamera:
    """Camera that copies each new frame to a ring as well.

    `latest` makes the copy, in the tracking thread. A frame of another size is not copied.

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
