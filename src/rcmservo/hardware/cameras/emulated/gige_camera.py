"""A GigE Vision camera on this computer's own network, whose frames are somebody else's: Aravis'
fake camera, with its picture replaced.

It speaks the real protocol, registers and packets and all, to any client. A frame is sent as soon
as there is a new one, if the camera's own pace allows, and is stamped with the middle of its
exposure.
"""

import ctypes
import socket
import threading
import time
from typing import Any

import cv2
import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.hardware.cameras.aravis import FORMATS
from rcmservo.hardware.cameras.aravis_library import FILL, aravis
from rcmservo.interfaces import Camera, Frame, Image
from rcmservo.ports import refusal

HOST = "127.0.0.1"
PORT = 3956
"""That of the GigE Vision Control Protocol."""
WIDTH, HEIGHT, SENSOR_WIDTH, SENSOR_HEIGHT = 0x100, 0x104, 0x11C, 0x118
PIXEL_FORMAT, PERIOD = 0x128, 0x138
"""The fake camera's registers (arvfakecamera.h); the last is in µs."""
RGB8 = 0x02180014
RATE = 60.0
"""Frames/s, where the client does not choose."""
WAIT = 0.25
"""s after which it sends the last frame again, so that it has time to answer its client."""
LOOK = 0.0005
"""s between looks whether there is a new frame."""
DISCOVERY = bytes((0x42, 0x11, 0, 2, 0, 0, 0xFF, 0xFF))
"""What asks a GigE Vision device who it is."""
NUDGE = 0.004
"""s between two of them: Aravis 0.8.26 oversleeps by several frames where its next one comes due
just as it looks at the clock, and what it hears wakes it."""


class GigeCamera:
    """Offers the frames of a camera, of this size, to one client after the other."""

    def __init__(self, camera: Camera, width: int, height: int, serial: str = "RCM1") -> None:
        self._camera, self._last, self._over = camera, -1, threading.Event()
        self._library = aravis()
        self._fill = FILL(self._filled)  # kept: the library calls it
        _require_free()
        call = self._library.call
        self._device = call("gv_fake_camera_new", HOST.encode(), serial.encode())
        if not self._device or not call("gv_fake_camera_is_running", self._device):
            raise RcmServoError(f"the emulated camera cannot listen on {HOST}, port {PORT}")
        inside = call("gv_fake_camera_get_fake_camera", self._device)
        for register, value in (
            (SENSOR_WIDTH, width),
            (SENSOR_HEIGHT, height),
            (WIDTH, width),
            (HEIGHT, height),
            (PIXEL_FORMAT, RGB8),
            (PERIOD, round(1e6 / RATE)),
        ):
            call("fake_camera_write_register", inside, register, value)
        fill = ctypes.cast(self._fill, ctypes.c_void_p)
        call("fake_camera_set_fill_pattern", inside, fill, None)
        self._nudging = threading.Thread(target=self._nudge, daemon=True)
        self._nudging.start()

    @property
    def address(self) -> str:
        """Where it is, for an Aravis client."""
        return HOST

    def close(self) -> None:
        """Be gone."""
        self._over.set()
        self._nudging.join()
        self._library.release(self._device)

    def _filled(self, buffer: int, _: int, exposure: int, gain: int, number: int) -> None:
        """Put the next frame in a buffer: the library calls it when one is due."""
        del exposure, gain
        call = self._library.call
        frame = self._next()
        if frame is None or frame.image is None:
            return
        size = [call(f"buffer_get_image_{name}", buffer) for name in ("height", "width")]
        place, _ = self._library.data(buffer)
        content = sent(frame.image, size[0], size[1], number)
        ctypes.memmove(place, content.ctypes.data, content.nbytes)  # as long as the payload or less
        call("buffer_set_timestamp", buffer, frame.exposure)

    def _next(self) -> Frame | None:
        """The newest frame, once it is new or has been waited for long enough."""
        until = time.monotonic() + WAIT
        while True:
            frame = self._camera.latest()
            new = frame is not None and frame.number != self._last
            if new or time.monotonic() > until or self._over.is_set():
                self._last = -1 if frame is None else frame.number
                return frame
            time.sleep(LOOK)

    def _nudge(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            wire.setblocking(False)
            while not self._over.wait(NUDGE):
                wire.sendto(DISCOVERY, (HOST, PORT))
                _emptied(wire)


def sent(image: Image, height: int, width: int, number: int) -> Image:
    """The upper left part of a picture, of this size, in a pixel format: as its bytes are sent."""
    part = image
    if image.shape[:2] != (height, width):
        part = np.zeros((height, width, 3), np.uint8)
        rows, columns = min(height, image.shape[0]), min(width, image.shape[1])
        part[:rows, :columns] = image[:rows, :columns]
    name = FORMATS[number][0] if number in FORMATS else "Mono8"
    match name:
        case "RGB8":
            return np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2RGB), np.uint8)
        case "BGR8":
            return np.ascontiguousarray(part)
        case "Mono8":
            return np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), np.uint8)
        case _:
            return _mosaic(part, name)


def _mosaic(image: Image, name: str) -> Image:
    """What a sensor with colour filters sees, such as BayerRG8: R G over G B."""
    first, second = name[5], name[6]
    rows = {"R": "RG", "B": "BG", "G": "GR" if second == "R" else "GB"}[first]
    below = {"RG": "GB", "BG": "GR", "GR": "BG", "GB": "RG"}[rows]
    seen = np.empty(image.shape[:2], np.uint8)
    for i, line in enumerate((rows, below)):
        for j, colour in enumerate(line):
            seen[i::2, j::2] = image[i::2, j::2, "BGR".index(colour)]
    return seen


def _require_free() -> None:
    """The library does not say that somebody else has the port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        try:
            wire.bind((HOST, PORT))
        except OSError as error:
            raise RcmServoError(refusal(PORT, error)) from error


def _emptied(wire: Any) -> None:
    """Read what a socket has heard, and forget it."""
    try:
        while wire.recv(2048):
            pass
    except (BlockingIOError, ConnectionError):
        return
