"""GigE Vision and USB3 Vision cameras.

The camera's own times say how much later than the least delayed frame each one came; `latency` is
what that one needed from the middle of its exposure. A frame that lacks packets is dropped and
counted, and so are those whose numbers never came.
"""

import contextlib
import ctypes
import time
from functools import partial
from typing import Any, cast

import cv2
import numpy as np

from rcmservo.hardware.cameras.aravis_library import (
    CHECKED,
    CONTINUOUS,
    OFF,
    SUCCESS,
    Aravis,
    AravisError,
    aravis,
)
from rcmservo.hardware.cameras.clock_map import ClockMap
from rcmservo.hardware.cameras.frame_ids import FrameIds
from rcmservo.hardware.cameras.settings import AravisSettings, require_taken
from rcmservo.hardware.cameras.streamed import CameraLost, Snapshot, StreamedCamera
from rcmservo.interfaces import Image

BUFFERS = 8
"""Frames that may be on their way at once."""
LOOK = 100_000
"""µs after which somebody may want to close a camera from which nothing comes."""
GONE = 2.0
"""s without a frame after which the camera is taken for lost, and opened again."""
AS_IT_IS = -1
"""Of a region, what is not to be changed."""

FORMATS: dict[int, tuple[str, int | None]] = {
    0x02180014: ("RGB8", cv2.COLOR_RGB2BGR),
    0x02180015: ("BGR8", None),
    0x01080009: ("BayerRG8", cv2.COLOR_BayerRGGB2BGR),
    0x01080008: ("BayerGR8", cv2.COLOR_BayerGRBG2BGR),
    0x0108000A: ("BayerGB8", cv2.COLOR_BayerGBRG2BGR),
    0x0108000B: ("BayerBG8", cv2.COLOR_BayerBGGR2BGR),
    0x01080001: ("Mono8", cv2.COLOR_GRAY2BGR),
}
"""Pixel formats in the order in which they are asked for, and how each becomes blue-green-red."""


def aravis_camera(settings: AravisSettings) -> StreamedCamera:
    """The camera, open."""
    return StreamedCamera(partial(AravisStream, settings, aravis()))


class AravisStream:
    """One connection to it."""

    def __init__(self, settings: AravisSettings, library: Aravis) -> None:
        self._library, self._address = library, settings.address
        self._latency = round(settings.latency * 1e9)
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
        self._heard = time.monotonic()

    def next(self) -> Snapshot | None:
        call, stream = self._library.call, self._stream
        buffer = call("stream_timeout_pop_buffer", stream, LOOK)
        if not buffer:
            if time.monotonic() - self._heard > GONE:
                raise CameraLost(f"camera {self._address}: no more frames come")
            return None
        self._heard = time.monotonic()
        missed = passed = spoilt = 0
        while True:
            arrival = time.monotonic_ns()
            missed += self._ids.step(call("buffer_get_frame_id", buffer)) - 1
            whole = call("buffer_get_status", buffer) == SUCCESS
            later = call("stream_try_pop_buffer", stream)
            if not later:
                break
            passed, spoilt = passed + whole, spoilt + (not whole)
            call("stream_push_buffer", stream, buffer)
            buffer = later
        image = self._image(buffer) if whole else None
        exposure, uncertainty = arrival, float("nan")
        stamp = call("buffer_get_timestamp", buffer) if whole else 0
        if stamp:
            exposure = self._clock.take(stamp, arrival)
            uncertainty = self._clock.uncertainty
        call("stream_push_buffer", stream, buffer)
        exposure -= self._latency
        return Snapshot(image, exposure, arrival, missed, passed, spoilt, uncertainty)

    def close(self) -> None:
        """Stop the camera, and let it go: in this order, for the camera ends the stream."""
        stream, camera, self._stream, self._camera = self._stream, self._camera, None, None
        if camera:
            with contextlib.suppress(AravisError):
                self._library.call("camera_stop_acquisition", camera)
        for thing in (stream, camera):
            if thing:
                self._library.release(thing)

    def _set_up(self, s: AravisSettings) -> None:
        """Set what is given, and read it back. How fast frames can come depends on how long one is
        exposed, and some cameras expose for less where they must come faster."""
        call, camera = self._library.call, self._camera
        call("camera_set_range_check_policy", camera, CHECKED)
        self._choose_format()
        if s.width is not None or s.height is not None:
            size = s.width or AS_IT_IS, s.height or AS_IT_IS
            call("camera_set_region", camera, AS_IT_IS, AS_IT_IS, *size)
            taken = [ctypes.c_int() for _ in range(4)]
            call("camera_get_region", camera, *map(ctypes.byref, taken))
            for name, wanted, it in zip(("width", "height"), size, taken[2:], strict=True):
                if wanted != AS_IT_IS:
                    require_taken(name, wanted, it.value, 0.0)
        for what in ("exposure_time", "gain"):
            given = s.exposure if what == "exposure_time" else s.gain
            auto = what.partition("_")[0]
            if given is not None and call(f"camera_is_{auto}_auto_available", camera):
                call(f"camera_set_{what}_auto", camera, OFF)
        wanted = (
            ("exposure", "exposure_time", s.exposure, 1e6, 0.05),
            ("gain", "gain", s.gain, 1.0, 0.05),
            ("frame_rate", "frame_rate", s.frame_rate, 1.0, 0.01),
        )
        given = [(name, key, v, unit, near) for name, key, v, unit, near in wanted if v is not None]
        for _, what, value, unit, _ in given:
            call(f"camera_set_{what}", camera, value * unit)
        for name, what, value, unit, near in given:
            require_taken(name, value, call(f"camera_get_{what}", camera) / unit, near)
        if call("camera_is_gv_device", camera):
            call("camera_gv_set_packet_size", camera, s.bytes_of_packet)
            size = call("camera_gv_get_packet_size", camera)
            require_taken("packet_size", s.bytes_of_packet, size, 0.05)

    def _choose_format(self) -> None:
        for number in FORMATS:
            with contextlib.suppress(AravisError):
                self._library.call("camera_set_pixel_format", self._camera, number)
                return
        names = ", ".join(name for name, _ in FORMATS.values())
        raise CameraLost(f"camera {self._address}: has none of the pixel formats {names}")

    def _start(self) -> None:
        call, camera = self._library.call, self._camera
        call("camera_clear_triggers", camera)
        call("camera_set_acquisition_mode", camera, CONTINUOUS)
        self._stream = call("camera_create_stream", camera, None, None)
        size = call("camera_get_payload", camera)
        for _ in range(BUFFERS):
            call("stream_push_buffer", self._stream, call("buffer_new_allocate", size))
        call("camera_start_acquisition", camera)

    def _image(self, buffer: int) -> Image | None:
        """A copy of a whole frame, blue-green-red; None where it is not what was asked for."""
        call = self._library.call
        names = "width", "height", "pixel_format"
        width, height, number = (call(f"buffer_get_image_{name}", buffer) for name in names)
        place, room = self._library.data(buffer)
        return picture(number, width, height, place, room)


def picture(number: int, width: int, height: int, place: int, room: int) -> Image | None:
    """A frame of this pixel format and size as blue-green-red, copied from its place in memory;
    None where it is not one or has not room."""
    if number not in FORMATS or min(width, height) < 1 or not place:
        return None
    name, conversion = FORMATS[number]
    shape = (height, width, 3) if name in ("RGB8", "BGR8") else (height, width)
    if int(np.prod(shape)) > room:
        return None
    content = (ctypes.c_uint8 * int(np.prod(shape))).from_address(place)
    raw = np.ctypeslib.as_array(content).reshape(shape)
    return raw.copy() if conversion is None else cast(Image, cv2.cvtColor(raw, conversion))
