"""Driver of GigE Vision and USB3 Vision cameras, with the Aravis library.

These standards for industrial cameras give each frame a time stamp and an id. The stamps show how
much later a frame arrives than the least delayed one. The setting `latency` is the time from the
middle of the exposure to the arrival of the least delayed frame. Frames with missing packets are
dropped and counted. Gaps between the ids are counted as lost frames.
"""

import contextlib
import ctypes
import time
from functools import partial
from typing import Any

from rcmservo.hardware.cameras import aravis_library
from rcmservo.hardware.cameras.aravis_library import Aravis, AravisError, load_aravis
from rcmservo.hardware.cameras.clock_map import ClockMap
from rcmservo.hardware.cameras.pixel_formats import PIXEL_FORMATS, decode_raw_image
from rcmservo.hardware.cameras.settings import (
    AravisSettings,
    require_accepted,
    set_parameters,
)
from rcmservo.hardware.cameras.streamed_camera import CameraLost, Snapshot, StreamedCamera
from rcmservo.interfaces import Image

BUFFER_COUNT = 8
"""Frames in transit at a time."""
READ_TIMEOUT_US = 100_000
"""Wait for a frame, short enough to close a silent camera soon."""
LOST_AFTER_S = 2.0
"""Time without a frame after which the camera counts as lost and is reopened."""
UNCHANGED = -1
"""Value of a region's field that stays as it is."""

MAX_16_BIT_ID = 65535
"""Last 16-bit frame id of GigE Vision, which is followed by 1. Newer devices count further."""
MAX_LOST_FRAMES = 10_000
"""Largest gap between two ids. A larger gap is a restart of the counter."""


def open_aravis_camera(settings: AravisSettings) -> StreamedCamera:
    """Open the camera."""
    return StreamedCamera(partial(AravisStream, settings, load_aravis()))


class AravisStream:
    """Connection to one camera."""

    def __init__(self, settings: AravisSettings, library: Aravis) -> None:
        self._library, self._address = library, settings.address
        self._latency_ns = round(settings.latency * 1e9)
        self._ids, self._clock = FrameIds(), ClockMap()
        self._camera: Any = None
        self._stream: Any = None
        try:
            self._camera = library.call("camera_new", settings.address.encode())
            self._set_up(settings)
            self._start()
        except AravisError as error:
            self.close()
            raise CameraLost(f"camera {settings.address}: {error}") from error
        except BaseException:
            self.close()
            raise
        self._last_frame_time = time.monotonic()

    def read(self) -> Snapshot | None:
        call, stream = self._library.call, self._stream
        buffer = call("stream_timeout_pop_buffer", stream, READ_TIMEOUT_US)
        if not buffer:
            if time.monotonic() - self._last_frame_time > LOST_AFTER_S:
                raise CameraLost(f"camera {self._address}: no more frames come")
            return None
        self._last_frame_time = time.monotonic()
        lost = skipped = incomplete = 0
        while True:
            arrival = time.monotonic_ns()
            lost += self._ids.step(call("buffer_get_frame_id", buffer)) - 1
            is_complete = call("buffer_get_status", buffer) == aravis_library.BUFFER_COMPLETE
            newer_buffer = call("stream_try_pop_buffer", stream)
            if not newer_buffer:
                break
            skipped, incomplete = skipped + is_complete, incomplete + (not is_complete)
            call("stream_push_buffer", stream, buffer)
            buffer = newer_buffer
        image = self._decode(buffer) if is_complete else None
        exposure, uncertainty = arrival, float("nan")
        stamp = call("buffer_get_timestamp", buffer) if is_complete else 0
        if stamp:
            exposure = self._clock.undelayed_arrival(stamp, arrival)
            uncertainty = self._clock.uncertainty
        call("stream_push_buffer", stream, buffer)
        exposure -= self._latency_ns
        return Snapshot(image, exposure, arrival, lost, skipped, incomplete, uncertainty)

    def close(self) -> None:
        """Stop and release the camera. The stream is released first, because the camera ends it."""
        stream, camera, self._stream, self._camera = self._stream, self._camera, None, None
        if camera:
            with contextlib.suppress(AravisError):
                self._library.call("camera_stop_acquisition", camera)
        for instance in (stream, camera):
            if instance:
                self._library.release(instance)

    def _set_up(self, settings: AravisSettings) -> None:
        """Set the given settings and read them back."""
        call, camera = self._library.call, self._camera
        call("camera_set_range_check_policy", camera, aravis_library.RANGE_CHECK_ENABLED)
        self._choose_format()
        self._set_image_size(settings)
        for key, value in (("exposure_time", settings.exposure), ("gain", settings.gain)):
            feature = key.partition("_")[0]
            if value is not None and call(f"camera_is_{feature}_auto_available", camera):
                call(f"camera_set_{key}_auto", camera, aravis_library.AUTO_OFF)
        parameters = (
            ("exposure", "exposure_time", settings.exposure, 1e6, 0.05),
            ("gain", "gain", settings.gain, 1.0, 0.05),
            ("frame_rate", "frame_rate", settings.frame_rate, 1.0, 0.01),
        )
        set_parameters(
            parameters,
            lambda key, value: call(f"camera_set_{key}", camera, value),
            lambda key: call(f"camera_get_{key}", camera),
        )
        if call("camera_is_gv_device", camera):
            packet_size = settings.effective_packet_size
            call("camera_gv_set_packet_size", camera, packet_size)
            actual_size = call("camera_gv_get_packet_size", camera)
            require_accepted("packet_size", packet_size, actual_size, 0.05)

    def _set_image_size(self, settings: AravisSettings) -> None:
        sizes = {"width": settings.width, "height": settings.height}
        if any(sizes.values()):
            call, camera = self._library.call, self._camera
            requested = [size or UNCHANGED for size in sizes.values()]
            call("camera_set_region", camera, UNCHANGED, UNCHANGED, *requested)
            region = [ctypes.c_int() for _ in range(4)]
            call("camera_get_region", camera, *map(ctypes.byref, region))
            for (name, size), actual in zip(sizes.items(), region[2:], strict=True):
                if size is not None:
                    require_accepted(name, size, actual.value, 0.0)

    def _choose_format(self) -> None:
        for code in PIXEL_FORMATS:
            with contextlib.suppress(AravisError):
                self._library.call("camera_set_pixel_format", self._camera, code)
                return
        names = ", ".join(name for name, _ in PIXEL_FORMATS.values())
        raise CameraLost(f"camera {self._address}: has none of the pixel formats {names}")

    def _start(self) -> None:
        call, camera = self._library.call, self._camera
        call("camera_clear_triggers", camera)
        call("camera_set_acquisition_mode", camera, aravis_library.ACQUISITION_CONTINUOUS)
        self._stream = call("camera_create_stream", camera, None, None)
        size = call("camera_get_payload", camera)
        for _ in range(BUFFER_COUNT):
            call("stream_push_buffer", self._stream, call("buffer_new_allocate", size))
        call("camera_start_acquisition", camera)

    def _decode(self, buffer: int) -> Image | None:
        """Return a copy of a complete frame, None if its format or size is unexpected."""
        call = self._library.call
        names = "width", "height", "pixel_format"
        width, height, code = (call(f"buffer_get_image_{name}", buffer) for name in names)
        address, size = self._library.find_data(buffer)
        return decode_raw_image(code, width, height, address, size)


class FrameIds:
    """Differences between the frame ids of one connection, across the wrap of 16-bit ids."""

    def __init__(self) -> None:
        self._last: int | None = None

    def step(self, frame_id: int) -> int:
        """Return the difference to the previous id.

        It is 1 if no frame is missing or the counter has restarted.
        """
        last, self._last = self._last, frame_id
        if last is None:
            return 1
        step = frame_id - last
        if step < 0 and last <= MAX_16_BIT_ID:
            step += MAX_16_BIT_ID
        return step if 1 <= step <= MAX_LOST_FRAMES else 1
