"""Frames of a camera from process to process, in a ring of shared memory."""

import struct
from multiprocessing.context import BaseContext

import numpy as np

from rcmservo.constraints import between
from rcmservo.errors import require
from rcmservo.interfaces import Frame
from rcmservo.live.lab import LabCamera
from rcmservo.live.shared_ring import SharedRing
from rcmservo.loop.run_result import CameraAccount

SLOTS = 8
TIMES = struct.Struct("<qqq")
"""Number of a frame, exposure ns and arrival ns, before its pixels."""


class FrameRing:
    """The newest frames of one camera. It is handed to a process when that is started, not
    later."""

    def __init__(self, context: BaseContext, width: int, height: int) -> None:
        for name, value in (("width", width), ("height", height)):
            between(1, 4096, "a number of px").require(name, value)
        self.shape = height, width, 3
        self.entries = SharedRing(context, SLOTS, TIMES.size + height * width * 3)

    def publish(self, frame: Frame) -> None:
        """Add a frame as the newest."""
        image = frame.image
        good = image is not None and image.shape == self.shape and image.dtype == np.uint8
        require(
            good,
            "frame.image",
            None if image is None else image.shape,
            f"a picture of the shape {self.shape}",
        )
        assert image is not None
        times = TIMES.pack(frame.number, frame.exposure, frame.arrival)
        self.entries.put(times, np.ascontiguousarray(image).data.cast("B"))

    def read(self, entry: int) -> Frame | None:
        """Return a frame by its entry; None if it is overwritten. A damaged one has no image."""
        found = self.entries.read(entry)
        if found is None:
            return None
        pixels = np.frombuffer(found.data, np.uint8, offset=TIMES.size)
        image = pixels.reshape(self.shape) if found.is_sound else None
        return Frame(*TIMES.unpack_from(found.data), image=image)


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


class ShownCamera:
    """A camera whose frames can be seen in a ring too. They are put there by whoever looks, in the
    thread that tracks. A picture of another size is not shown."""

    def __init__(self, camera: LabCamera, ring: FrameRing) -> None:
        self._camera, self._ring = camera, ring
        self._shown: Frame | None = None

    def latest(self) -> Frame | None:
        frame = self._camera.latest()
        if frame is not None and frame is not self._shown:
            self._shown = frame
            if frame.image is not None and frame.image.shape == self._ring.shape:
                self._ring.publish(frame)
        return frame

    def account(self) -> CameraAccount:
        """What became of its frames so far."""
        return self._camera.account()

    def close(self) -> None:
        """Let it go."""
        self._camera.close()
