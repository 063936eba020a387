"""Pictures from process to process: a ring in shared memory, one writer, and readers that never
wait.

The writer fills the oldest slot and only then says which is the newest. A reader copies that and
looks again: a slot that changed meanwhile is not used, and a checksum catches what else went wrong.
The memory has no name, so that nothing is left of it when its processes are gone, however they end.
"""

import struct
import zlib
from multiprocessing.context import BaseContext
from typing import Any

import numpy as np

from rcmservo.errors import require
from rcmservo.interfaces import Frame, Image
from rcmservo.live.lab import CameraAccount, LabCamera

SLOTS = 8
HEAD = struct.Struct("<qqqqI4x")
"""Count of the frame in this ring, its number, exposure ns, arrival ns, and a checksum of that and
the picture."""


class FrameRing:
    """Room for the last frames of one camera. It is handed to a process when that is started, not
    later."""

    def __init__(self, context: BaseContext, width: int, height: int) -> None:
        for name, value in (("width", width), ("height", height)):
            require(1 <= value <= 4096, name, value, "from 1 to 4096 px")
        self.shape = height, width, 3
        self.size = HEAD.size + height * width * 3
        self._memory: Any = context.RawArray("B", SLOTS * self.size)
        self._newest: Any = context.RawValue("q", -1)

    @property
    def newest(self) -> int:
        """Count of the newest frame, −1 before the first."""
        return self._newest.value

    def slot(self, count: int) -> memoryview:
        """The memory of a frame by its count."""
        start = count % SLOTS * self.size
        return memoryview(self._memory).cast("B")[start : start + self.size]

    def publish(self, frame: Frame) -> None:
        """Make a frame the newest: the camera's side."""
        image = frame.image
        good = image is not None and image.shape == self.shape and image.dtype == np.uint8
        require(
            good,
            "frame.image",
            None if image is None else image.shape,
            f"a picture of the shape {self.shape}",
        )
        assert image is not None
        count = self.newest + 1
        slot, pixels = self.slot(count), np.ascontiguousarray(image).data.cast("B")
        HEAD.pack_into(slot, 0, -1, 0, 0, 0, 0)
        slot[HEAD.size :] = pixels
        numbers = count, frame.number, frame.exposure, frame.arrival
        HEAD.pack_into(slot, 0, *numbers, _checksum(numbers, pixels))
        self._newest.value = count


def _checksum(numbers: tuple[int, ...], pixels: memoryview) -> int:
    return zlib.crc32(pixels, zlib.crc32(struct.pack("<qqqq", *numbers)))


class RingCamera:
    """The reader's side, as a camera. A damaged frame comes without its picture."""

    def __init__(self, ring: FrameRing) -> None:
        self._ring = ring
        self._count = -1
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        count = self._ring.newest
        if count > self._count:
            self._read(count)
        return self._frame

    def _read(self, count: int) -> None:
        slot = self._ring.slot(count)
        head, pixels = HEAD.unpack_from(slot), bytes(slot[HEAD.size :])
        if head[0] != count or HEAD.unpack_from(slot) != head:
            return
        good = _checksum(head[:4], memoryview(pixels)) == head[4]
        image: Image | None = (
            np.frombuffer(pixels, np.uint8).reshape(self._ring.shape) if good else None
        )
        self._count, self._frame = count, Frame(head[1], head[2], head[3], image=image)


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
