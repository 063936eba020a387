"""Driver of a camera that publishes on a ROS topic.

Images are stamped with the calendar times of their exposures. The driver reads this computer's
calendar time and monotonic clock together to convert a stamp. The uncertainty is then the time that
this reading takes, if the same computer has set the stamp. The offset between two computers' clocks
is not measured. Lost images are not sent again and have no numbers, so their count is unknown.
"""

import time
from collections.abc import Callable
from threading import Condition
from typing import Any, cast

import cv2
import numpy as np

from rcmservo.hardware.cameras.pixel_formats import decode_image_file
from rcmservo.hardware.cameras.settings import TopicSettings
from rcmservo.hardware.cameras.streamed_camera import CameraLost, Snapshot, StreamedCamera
from rcmservo.hardware.crtk.messages import CompressedImage, PlainImage, Topic, Transport
from rcmservo.hardware.crtk.received_state import MAX_STAMP_LEAD_NS
from rcmservo.hardware.crtk.transport import open_transport
from rcmservo.interfaces import Image

READ_TIMEOUT_S = 0.1
"""Wait for an image in one call."""
MAX_IMAGE_AGE_NS = 1_000_000_000
"""Age above which an image is refused."""
CHANNELS = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4, "mono8": 1, "8UC3": 3, "8UC1": 1}
"""Bytes per pixel of each supported encoding."""
CONVERSIONS = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
}
"""OpenCV conversion of each encoding to blue-green-red."""


def open_topic_camera(settings: TopicSettings) -> StreamedCamera:
    """Subscribe to the camera's topic. The camera need not publish yet."""
    return StreamedCamera(lambda: TopicStream(settings, open_transport(settings)))


class TopicStream:
    """Subscription to one topic.

    Parameters
    ----------
    settings : TopicSettings
        Topic and latency.
    transport : Transport
        Open transport, which `close` closes.
    now, calendar_now : callable
        Functions that return the present time in ns, of a monotonic clock and as calendar time.
    """

    def __init__(
        self,
        settings: TopicSettings,
        transport: Transport,
        now: Callable[[], int] = time.monotonic_ns,
        calendar_now: Callable[[], int] = time.time_ns,
    ) -> None:
        self._settings, self._transport = settings, transport
        self._now, self._calendar_now = now, calendar_now
        self._image_received = Condition()
        self._newest: tuple[PlainImage | CompressedImage, int, int, float] | None = None
        """Newest message, its arrival on both clocks in ns, and the uncertainty of its age in s."""
        self._skipped = self._newest_stamp = 0
        kind = CompressedImage if settings.compressed else PlainImage
        transport.subscribe(Topic(settings.topic, kind, lossy=True), self._receive)

    def read(self) -> Snapshot | None:
        with self._image_received:
            self._image_received.wait_for(lambda: self._newest is not None, READ_TIMEOUT_S)
            if self._newest is None:
                return None
            (message, arrival, calendar_arrival, uncertainty), self._newest = self._newest, None
            skipped, self._skipped = self._skipped, 0
        age = calendar_arrival - message.stamp
        if not -MAX_STAMP_LEAD_NS <= age <= MAX_IMAGE_AGE_NS:
            invalid_age = f"images are {age * 1e-9:.3f} s old by their stamps"
            problem = invalid_age if message.stamp else "images have no stamp"
            raise CameraLost(f"camera {self._settings.topic}: {problem}")
        is_newer = message.stamp > self._newest_stamp
        self._newest_stamp = max(message.stamp, self._newest_stamp)
        exposure = arrival - max(age, 0) - round(self._settings.latency * 1e9)
        image = self._decode(message) if is_newer else None
        return Snapshot(image, exposure, arrival, skipped=skipped, uncertainty=uncertainty)

    def close(self) -> None:
        self._transport.close()

    def _receive(self, message: PlainImage | CompressedImage, writer: str) -> None:
        """Keep an image with its arrival. The uncertainty is the time of reading both clocks.

        It is NaN if another computer may have set the stamp.
        """
        before = self._now()
        calendar_arrival, arrival = self._calendar_now(), self._now()
        is_local = self._settings.ros == 2 and self._settings.interface == "lo"
        uncertainty = (arrival - before) * 1e-9 if is_local else float("nan")
        with self._image_received:
            self._skipped += self._newest is not None
            self._newest = message, arrival, calendar_arrival, uncertainty
            self._image_received.notify_all()

    def _decode(self, message: PlainImage | CompressedImage) -> Image | None:
        """Return the image as blue-green-red, None if it is damaged."""
        try:
            if isinstance(message, CompressedImage):
                return decode_image_file(message.data)
            return self._decode_plain(message)
        except cv2.error:
            return None

    def _decode_plain(self, message: PlainImage) -> Image | None:
        channels = CHANNELS.get(message.encoding)
        if channels is None:
            supported = ", ".join(CHANNELS)
            problem = f"images have the encoding {message.encoding[:40]!r}; expected {supported}"
            raise CameraLost(f"camera {self._settings.topic}: {problem}")
        row_bytes = channels * message.width
        is_complete = len(message.data) == message.step * message.height > 0
        if not 0 < row_bytes <= message.step or not is_complete:
            return None
        rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
        pixels = rows[:, :row_bytes].reshape(message.height, message.width, channels)
        conversion = CONVERSIONS.get(message.encoding)
        return pixels if conversion is None else cast(Any, cv2.cvtColor(pixels, conversion))
