"""Cameras that OpenCV reads. They tell no times: a frame's exposure lies `latency` before its
arrival.

A device's buffer holds one frame, and the network's pictures are not kept back, so that what is
read is new; files play at their own pace, and never faster to catch up.
"""

import os
import time
from functools import partial
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from rcmservo.hardware.cameras.packed import unpacked
from rcmservo.hardware.cameras.settings import OpencvSettings, require_taken
from rcmservo.hardware.cameras.streamed import CameraLost, Snapshot, StreamedCamera
from rcmservo.interfaces import Image
from rcmservo.loop.clock import sleep_until

OPEN_WITHIN = 3000
"""ms within which an address must answer."""
READ_WITHIN = 2000
"""ms within which its next picture must come."""
DEVICE_WITHIN = "2"
"""s within which a device's next picture must come; OpenCV reads it once in a process."""
LOOK = 100_000_000
"""ns after which somebody may want to close a file whose next frame is not due."""
MANUAL = 1
"""V4L2's word for an exposure that the camera does not choose."""
UNITS = 1e4
"""V4L2 counts exposures in 100 µs."""
MOTION_JPEG = cv2.VideoWriter.fourcc(*"MJPG")
PACKED = -1
"""Format in which FFmpeg gives each picture's file as it came."""
UNBUFFERED = "fflags;nobuffer|flags;low_delay"
"""What FFmpeg is told of the network, so that it keeps no frames back; a file's first ones would be
lost by it."""


def opencv_camera(settings: OpencvSettings) -> StreamedCamera:
    """The camera, open. A file or a sequence that has ended stays so."""
    lasting = settings.device or settings.remote
    return StreamedCamera(partial(OpencvStream, settings), lasting)


class OpencvStream:
    """One connection to it."""

    def __init__(self, settings: OpencvSettings) -> None:
        self._settings = settings
        os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = UNBUFFERED if settings.remote else ""
        os.environ["OPENCV_FFMPEG_LOGLEVEL"] = "-8"
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", DEVICE_WITHIN)
        cv2.utils.logging.setLogLevel(0)
        self._capture: Any = _capture(settings)
        if not self._capture.isOpened():
            raise CameraLost(f"camera {settings.source}: cannot be opened{_why(settings)}")
        try:
            self._packed = not settings.device and _packed(self._capture)
            self._period = self._set_up()
        except BaseException:
            self._capture.release()
            raise
        self._due = time.monotonic_ns()

    def next(self) -> Snapshot | None:
        if self._period:
            sleep_until(min(self._due, time.monotonic_ns() + LOOK))
            if time.monotonic_ns() < self._due:
                return None
            self._due = max(self._due + self._period, time.monotonic_ns())
        if not self._capture.grab():
            raise CameraLost(f"camera {self._settings.source}: {_ended(self._settings)}")
        arrival = time.monotonic_ns()
        exposure = arrival - round(self._settings.latency * 1e9)
        return Snapshot(self._image(), exposure, arrival)

    def _image(self) -> Image | None:
        try:
            whole, image = self._capture.retrieve()
            if whole and self._packed:
                return unpacked(image.tobytes())
            return _colour(image) if whole else None
        except cv2.error:
            return None

    def close(self) -> None:
        self._capture.release()

    def _set_up(self) -> int:
        """Set what is given; ns between two frames of a file, 0 where they come by themselves."""
        s = self._settings
        if s.device:
            self._set_device()
            return 0
        if s.remote:
            return 0
        rate = s.frame_rate or float(self._capture.get(cv2.CAP_PROP_FPS))
        if not 0.1 <= rate <= 1000.0:
            raise CameraLost(f"camera {s.source}: does not say its pace: set camera.frame_rate")
        return round(1e9 / rate)

    def _set_device(self) -> None:
        s = self._settings
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if s.exposure is not None:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL)
        wanted = (
            ("width", cv2.CAP_PROP_FRAME_WIDTH, s.width, 1.0, 0.0),
            ("height", cv2.CAP_PROP_FRAME_HEIGHT, s.height, 1.0, 0.0),
            ("frame_rate", cv2.CAP_PROP_FPS, s.frame_rate, 1.0, 0.01),
            ("exposure", cv2.CAP_PROP_EXPOSURE, s.exposure, UNITS, 0.05),
            ("gain", cv2.CAP_PROP_GAIN, s.gain, 1.0, 0.05),
        )
        given = [(name, key, v, unit, near) for name, key, v, unit, near in wanted if v is not None]
        for _, key, value, unit, _ in given:
            self._capture.set(key, value * unit)
        for name, key, value, unit, near in given:
            require_taken(name, value, float(self._capture.get(key)) / unit, near)


def _capture(s: OpencvSettings) -> Any:
    if s.device:
        device = int(s.source) if s.source.isdecimal() else s.source
        return cv2.VideoCapture(cast(Any, device), cv2.CAP_V4L2)
    if s.remote:
        waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_WITHIN]
        waits += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_WITHIN, cv2.CAP_PROP_N_THREADS, 1]
        return cv2.VideoCapture(s.source, cv2.CAP_FFMPEG, waits)
    if "%" in s.source:
        return cv2.VideoCapture(s.source, cv2.CAP_IMAGES)
    return cv2.VideoCapture(s.source, cv2.CAP_FFMPEG)


def _packed(capture: Any) -> bool:
    """Whether it gives JPEG files, as it is told to where it has them, and not what FFmpeg makes of
    them."""
    if int(capture.get(cv2.CAP_PROP_FOURCC)) != MOTION_JPEG:
        return False
    return bool(capture.set(cv2.CAP_PROP_FORMAT, PACKED))


def _colour(image: Any) -> Image | None:
    """A picture blue-green-red; None of what is none."""
    if image is None or image.dtype != np.uint8:
        return None
    if image.ndim == 2:
        return cast(Image, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    return cast(Image, image) if image.shape[2] == 3 else None


def _why(s: OpencvSettings) -> str:
    path = Path(f"/dev/video{s.source}" if s.source.isdecimal() else s.source)
    if s.remote:
        return ": nothing sends pictures there"
    if not s.device:
        return ": no video or no picture that can be read"
    if not path.exists():
        return f": there is no {path}"
    if not os.access(path, os.R_OK | os.W_OK):
        return f": {path} is not yours to read (sudo usermod -aG video $USER, and log in again)"
    return ": it is in use, or no camera"


def _ended(s: OpencvSettings) -> str:
    return "no more pictures come" if s.device or s.remote else "the file has ended"
