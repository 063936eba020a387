"""Driver of cameras that OpenCV reads: video devices, files, image sequences and network streams.

OpenCV gives no time stamps, so the exposure of a frame is taken as `latency` before its arrival. A
device buffers one frame and network streams are not buffered, so frames are recent. Files play at
their own rate, and never faster to catch up.
"""

import os
import time
from functools import partial
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from rcmservo.hardware.cameras.pixel_formats import decode_image_file
from rcmservo.hardware.cameras.settings import OpencvSettings, set_parameters
from rcmservo.hardware.cameras.streamed_camera import CameraLost, Snapshot, StreamedCamera
from rcmservo.interfaces import Image
from rcmservo.loop.clock import sleep_until

OPEN_TIMEOUT_MS = 3000
"""Time limit for a network address to answer."""
READ_TIMEOUT_MS = 2000
"""Time limit for the next image from a network address."""
DEVICE_TIMEOUT_S = "2"
"""Time limit for the next image of a device. OpenCV reads this variable once per process."""
MAX_WAIT_NS = 100_000_000
"""Longest wait for a file's next frame, short enough to close the file soon."""
MANUAL_EXPOSURE = 1
"""V4L2 value of a manual exposure."""
EXPOSURE_UNITS_PER_S = 1e4
"""V4L2 measures exposures in 100 µs."""
MOTION_JPEG = cv2.VideoWriter.fourcc(*"MJPG")
ENCODED_FORMAT = -1
"""Format in which FFmpeg returns the encoded image."""
MIN_PLAYBACK_RATE, MAX_PLAYBACK_RATE = 0.1, 1000.0
"""Plausible frame rates of a file, frames/s."""
UNBUFFERED_OPTIONS = "fflags;nobuffer|flags;low_delay"
"""FFmpeg options against buffering of network streams. A file would lose its first frames."""


def open_opencv_camera(settings: OpencvSettings) -> StreamedCamera:
    """Open the camera. A file or sequence that has ended is not reopened."""
    return StreamedCamera(partial(OpencvStream, settings), reopens=settings.is_live)


class OpencvStream:
    """Connection to one camera or file."""

    def __init__(self, settings: OpencvSettings) -> None:
        self._settings = settings
        ffmpeg_options = UNBUFFERED_OPTIONS if settings.is_remote else ""
        os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = ffmpeg_options
        os.environ["OPENCV_FFMPEG_LOGLEVEL"] = "-8"
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", DEVICE_TIMEOUT_S)
        cv2.utils.logging.setLogLevel(0)
        self._capture: Any = _open_capture(settings)
        if not self._capture.isOpened():
            reason = _explain_open_failure(settings)
            raise CameraLost(f"camera {settings.source}: cannot be opened: {reason}")
        try:
            self._is_encoded = not settings.is_device and _request_encoded(self._capture)
            if settings.is_device:
                self._set_device()
            self._period_ns = 0 if settings.is_live else self._playback_period()
        except BaseException:
            self._capture.release()
            raise
        self._next_frame_time = time.monotonic_ns()

    def read(self) -> Snapshot | None:
        if self._period_ns:
            sleep_until(min(self._next_frame_time, time.monotonic_ns() + MAX_WAIT_NS))
            if time.monotonic_ns() < self._next_frame_time:
                return None
            self._next_frame_time += self._period_ns
            self._next_frame_time = max(self._next_frame_time, time.monotonic_ns())
        if not self._capture.grab():
            reason = "no more images come" if self._settings.is_live else "the file has ended"
            raise CameraLost(f"camera {self._settings.source}: {reason}")
        arrival = time.monotonic_ns()
        exposure = arrival - round(self._settings.latency * 1e9)
        return Snapshot(self._retrieve(), exposure, arrival)

    def _retrieve(self) -> Image | None:
        """Return the image of the grabbed frame, None if it is damaged."""
        try:
            is_complete, image = self._capture.retrieve()
            if is_complete and self._is_encoded:
                return decode_image_file(image.tobytes())
            return _to_colour(image) if is_complete else None
        except cv2.error:
            return None

    def close(self) -> None:
        self._capture.release()

    def _playback_period(self) -> int:
        """Return the frame period of a file in ns."""
        rate = self._settings.frame_rate or float(self._capture.get(cv2.CAP_PROP_FPS))
        if not MIN_PLAYBACK_RATE <= rate <= MAX_PLAYBACK_RATE:
            problem = "the file has no frame rate: set camera.frame_rate"
            raise CameraLost(f"camera {self._settings.source}: {problem}")
        return round(1e9 / rate)

    def _set_device(self) -> None:
        """Set the given settings of a device and read them back."""
        settings = self._settings
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if settings.exposure is not None:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, MANUAL_EXPOSURE)
        parameters = (
            ("width", cv2.CAP_PROP_FRAME_WIDTH, settings.width, 1.0, 0.0),
            ("height", cv2.CAP_PROP_FRAME_HEIGHT, settings.height, 1.0, 0.0),
            ("frame_rate", cv2.CAP_PROP_FPS, settings.frame_rate, 1.0, 0.01),
            ("exposure", cv2.CAP_PROP_EXPOSURE, settings.exposure, EXPOSURE_UNITS_PER_S, 0.05),
            ("gain", cv2.CAP_PROP_GAIN, settings.gain, 1.0, 0.05),
        )
        set_parameters(parameters, self._capture.set, self._capture.get)


def _open_capture(settings: OpencvSettings) -> Any:
    if settings.is_device:
        device = int(settings.source) if settings.source.isdecimal() else settings.source
        return cv2.VideoCapture(cast(Any, device), cv2.CAP_V4L2)
    if settings.is_remote:
        timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_TIMEOUT_MS]
        timeouts += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_TIMEOUT_MS, cv2.CAP_PROP_N_THREADS, 1]
        return cv2.VideoCapture(settings.source, cv2.CAP_FFMPEG, timeouts)
    if "%" in settings.source:
        return cv2.VideoCapture(settings.source, cv2.CAP_IMAGES)
    return cv2.VideoCapture(settings.source, cv2.CAP_FFMPEG)


def _request_encoded(capture: Any) -> bool:
    """Request JPEG files instead of decoded images; return True if the source has them."""
    if int(capture.get(cv2.CAP_PROP_FOURCC)) != MOTION_JPEG:
        return False
    return bool(capture.set(cv2.CAP_PROP_FORMAT, ENCODED_FORMAT))


def _to_colour(image: Any) -> Image | None:
    """Return an image as blue-green-red, None if it is not an 8-bit image."""
    if image is None or image.dtype != np.uint8:
        return None
    if image.ndim == 2:
        return cast(Image, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    return cast(Image, image) if image.shape[2] == 3 else None


def _explain_open_failure(settings: OpencvSettings) -> str:
    path = Path(f"/dev/video{settings.source}" if settings.source.isdecimal() else settings.source)
    if settings.is_remote:
        return "no images come from there"
    if not settings.is_device:
        return "not a readable video or image"
    if not path.exists():
        return f"there is no {path}"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"no permission to read {path} (sudo usermod -aG video $USER, and log in again)"
    return "it is in use, or not a camera"
