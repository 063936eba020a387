"""A camera whose pictures come on a ROS topic. Their stamps are when they were exposed, in calendar
time: within one computer it differs from the clock here by what is read in one go; by how much two
computers' clocks differ nobody measures.

Pictures are not sent again where they were lost, and bear no numbers: what never came is not known.
"""

import time
from collections.abc import Callable
from functools import partial
from threading import Condition
from typing import Any, cast

import cv2
import numpy as np

from rcmservo.hardware.cameras.packed import unpacked
from rcmservo.hardware.cameras.settings import TopicSettings
from rcmservo.hardware.cameras.streamed import CameraLost, Snapshot, StreamedCamera
from rcmservo.hardware.crtk.connection import open_transport
from rcmservo.hardware.crtk.messages import CompressedImage, PlainImage, Topic
from rcmservo.hardware.crtk.transport import Transport
from rcmservo.interfaces import Image

WAIT = 0.1
"""s that are waited for a picture in one go."""
OLD = 1_000_000_000
"""ns after which a picture is no news."""
AHEAD = 5_000_000
"""ns by which a stamp may be ahead of the clock here."""
CHANNELS = {"bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4, "mono8": 1, "8UC3": 3, "8UC1": 1}
"""Bytes of a pixel in each encoding that is read."""
CONVERT = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
}


def topic_camera(settings: TopicSettings) -> StreamedCamera:
    """The camera, open; whether pictures come is seen later."""
    return StreamedCamera(partial(_stream, settings))


def _stream(settings: TopicSettings) -> "TopicStream":
    transport = open_transport(settings)
    return TopicStream(settings, transport)


class TopicStream:
    """One subscription, whose transport it closes in the end."""

    def __init__(
        self,
        settings: TopicSettings,
        transport: Transport,
        now: Callable[[], int] = time.monotonic_ns,
        real: Callable[[], int] = time.time_ns,
    ) -> None:
        self._settings, self._transport, self._now, self._real = settings, transport, now, real
        self._told = Condition()
        self._waiting: tuple[PlainImage | CompressedImage, int, int, float] | None = None
        self._passed = self._newest = 0
        if settings.compressed:
            topic = Topic(settings.topic, CompressedImage, lossy=True)
            transport.subscribe(topic, self._hear)
        else:
            transport.subscribe(Topic(settings.topic, PlainImage, lossy=True), self._hear)

    def next(self) -> Snapshot | None:
        with self._told:
            self._told.wait_for(lambda: self._waiting is not None, WAIT)
            if self._waiting is None:
                return None
            (said, arrival, real, uncertainty), self._waiting = self._waiting, None
            passed, self._passed = self._passed, 0
        age = real - said.stamp
        if not -AHEAD <= age <= OLD:
            words = "bear no stamp" if not said.stamp else f"are {age * 1e-9:.3f} s old"
            raise CameraLost(f"camera {self._settings.topic}: by its stamps pictures {words}")
        newer, self._newest = said.stamp > self._newest, max(said.stamp, self._newest)
        exposure = arrival - max(age, 0) - round(self._settings.latency * 1e9)
        image = self._image(said) if newer else None
        return Snapshot(image, exposure, arrival, passed=passed, uncertainty=uncertainty)

    def close(self) -> None:
        self._transport.close()

    def _hear(self, said: PlainImage | CompressedImage, writer: str) -> None:
        before = self._now()
        real, after = self._real(), self._now()
        with self._told:
            self._passed += self._waiting is not None
            self._waiting = said, after, real, self._known((after - before) * 1e-9)
            self._told.notify_all()

    def _known(self, read: float) -> float:
        """s, how well the stamp is known on the clock here, which was read in so many s."""
        here = self._settings.ros == 2 and self._settings.interface == "lo"
        return read if here else float("nan")

    def _image(self, said: PlainImage | CompressedImage) -> Image | None:
        """Blue-green-red; None of what is damaged."""
        try:
            if isinstance(said, CompressedImage):
                return unpacked(said.data)
            return self._plain(said)
        except cv2.error:
            return None

    def _plain(self, said: PlainImage) -> Image | None:
        channels = CHANNELS.get(said.encoding)
        if channels is None:
            right = ", ".join(CHANNELS)
            words = f"pictures come as {said.encoding[:40]!r}, and only {right} are read"
            raise CameraLost(f"camera {self._settings.topic}: {words}")
        line = channels * said.width
        sound = 0 < line <= said.step and len(said.data) == said.step * said.height > 0
        if not sound:
            return None
        rows = np.frombuffer(said.data, np.uint8).reshape(said.height, said.step)[:, :line]
        pixels = rows.reshape(said.height, said.width, channels)
        code = CONVERT.get(said.encoding)
        return pixels if code is None else cast(Any, cv2.cvtColor(pixels, code))
