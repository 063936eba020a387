"""Emulated GigE Vision camera on the loopback interface: Aravis' fake camera with replaced images.

GigE Vision is a standard for industrial cameras on Ethernet, and Aravis a library for it. Any
client can use the camera: protocol, registers and packets are those of GigE Vision. The camera
sends each new frame at once, as far as its frame period allows, stamped with the middle of the
exposure.
"""

import ctypes
import socket
import threading
import time

import cv2
import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.hardware.cameras.aravis_library import FILL_CALLBACK, load_aravis
from rcmservo.hardware.cameras.pixel_formats import PIXEL_FORMATS
from rcmservo.interfaces import Camera, Frame, Image
from rcmservo.network_ports import describe_refusal

LOOPBACK = "127.0.0.1"
CONTROL_PORT = 3956
"""Port of the GigE Vision Control Protocol."""
WIDTH, HEIGHT, SENSOR_WIDTH, SENSOR_HEIGHT = 0x100, 0x104, 0x11C, 0x118
PIXEL_FORMAT, FRAME_PERIOD_US = 0x128, 0x138
"""Addresses of the fake camera's registers (arvfakecamera.h)."""
RGB8 = 0x02180014
BAYER_ROWS = {"BayerRG8": "RG GB", "BayerGR8": "GR BG", "BayerGB8": "GB RG", "BayerBG8": "BG GR"}
"""Colours of the filters in the first and second row of pixels."""
DEFAULT_RATE = 60.0
"""Frame rate in frames/s unless the client sets one."""
REPEAT_AFTER_S = 0.25
"""Time without a new frame after which the last one is sent again, so that the camera can answer
its client."""
POLL_PERIOD_S = 0.0005
"""Period of the checks for a new frame."""
DISCOVERY = bytes((0x42, 0x11, 0, 2, 0, 0, 0xFF, 0xFF))
"""Discovery request of GigE Vision."""
WAKE_PERIOD_S = 0.004
"""Period of the requests that wake the fake camera: Aravis 0.8.26 oversleeps by several frames if
the next frame becomes due just as it reads the clock."""


class GigeCamera:
    """Emulated camera for one client at a time.

    Parameters
    ----------
    camera : Camera
        Source of the frames.
    width, height : int
        Sensor size in px.
    serial : str
        Serial number.

    Raises
    ------
    RcmServoError
        If the control port is in use.
    """

    def __init__(self, camera: Camera, width: int, height: int, serial: str = "RCM1") -> None:
        self._camera, self._last_number = camera, -1
        self._closing = threading.Event()
        self._library = load_aravis()
        self._fill = FILL_CALLBACK(self._fill_buffer)  # keeps the callback alive
        _require_free_port()
        call = self._library.call
        self._device = call("gv_fake_camera_new", LOOPBACK.encode(), serial.encode())
        if not self._device or not call("gv_fake_camera_is_running", self._device):
            raise RcmServoError(
                f"the emulated camera cannot listen on {LOOPBACK}, port {CONTROL_PORT}"
            )
        fake_camera = call("gv_fake_camera_get_fake_camera", self._device)
        for register, value in (
            (SENSOR_WIDTH, width),
            (SENSOR_HEIGHT, height),
            (WIDTH, width),
            (HEIGHT, height),
            (PIXEL_FORMAT, RGB8),
            (FRAME_PERIOD_US, round(1e6 / DEFAULT_RATE)),
        ):
            call("fake_camera_write_register", fake_camera, register, value)
        fill = ctypes.cast(self._fill, ctypes.c_void_p)
        call("fake_camera_set_fill_pattern", fake_camera, fill, None)
        self._wake_thread = threading.Thread(target=self._keep_awake, daemon=True)
        self._wake_thread.start()

    @property
    def address(self) -> str:
        """Address for an Aravis client."""
        return LOOPBACK

    def close(self) -> None:
        """Stop the camera."""
        self._closing.set()
        self._wake_thread.join()
        self._library.release(self._device)

    def _fill_buffer(self, buffer: int, _: int, exposure: int, gain: int, code: int) -> None:
        """Copy the next frame into a buffer. The library calls this when a frame is due."""
        del exposure, gain
        call = self._library.call
        frame = self._wait_for_frame()
        if frame is None or frame.image is None:
            return
        height, width = (call(f"buffer_get_image_{side}", buffer) for side in ("height", "width"))
        address, _ = self._library.find_data(buffer)
        pixels = encode_image(frame.image, height, width, code)
        ctypes.memmove(address, pixels.ctypes.data, pixels.nbytes)  # at most the payload
        call("buffer_set_timestamp", buffer, frame.exposure)

    def _wait_for_frame(self) -> Frame | None:
        """Return the newest frame, once it is new or no new one has come for a while."""
        end = time.monotonic() + REPEAT_AFTER_S
        while True:
            frame = self._camera.latest()
            is_new = frame is not None and frame.number != self._last_number
            if is_new or time.monotonic() > end or self._closing.is_set():
                self._last_number = -1 if frame is None else frame.number
                return frame
            time.sleep(POLL_PERIOD_S)

    def _keep_awake(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp_socket:
            udp_socket.setblocking(False)
            while not self._closing.wait(WAKE_PERIOD_S):
                udp_socket.sendto(DISCOVERY, (LOOPBACK, CONTROL_PORT))
                _discard_input(udp_socket)


def encode_image(image: Image, height: int, width: int, code: int) -> Image:
    """Encode the upper left part of an image in a pixel format.

    Parameters
    ----------
    image : ndarray, shape (rows, columns, 3), uint8
        Blue-green-red image.
    height, width : int
        Size of the part in px.
    code : int
        GenICam pixel format; an unknown one is encoded as Mono8.

    Returns
    -------
    ndarray, uint8
        Pixels with the bytes of the format.
    """
    part = image
    if image.shape[:2] != (height, width):
        part = np.zeros((height, width, 3), np.uint8)
        rows, columns = min(height, image.shape[0]), min(width, image.shape[1])
        part[:rows, :columns] = image[:rows, :columns]
    name, _ = PIXEL_FORMATS.get(code, ("Mono8", None))
    match name:
        case "RGB8":
            return np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2RGB), np.uint8)
        case "BGR8":
            return np.ascontiguousarray(part)
        case "Mono8":
            return np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), np.uint8)
        case _:
            return _encode_bayer(part, *BAYER_ROWS[name].split())


def _encode_bayer(image: Image, *filter_rows: str) -> Image:
    """Sample an image with a colour filter array of two rows, such as RG over GB."""
    mosaic = np.empty(image.shape[:2], np.uint8)
    for i, filters in enumerate(filter_rows):
        for j, colour in enumerate(filters):
            mosaic[i::2, j::2] = image[i::2, j::2, "BGR".index(colour)]
    return mosaic


def _require_free_port() -> None:
    """Raise `RcmServoError` if the control port is in use, which the library does not report."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp_socket:
        try:
            udp_socket.bind((LOOPBACK, CONTROL_PORT))
        except OSError as error:
            raise RcmServoError(describe_refusal(CONTROL_PORT, error)) from error


def _discard_input(udp_socket: socket.socket) -> None:
    """Discard the received datagrams of a socket."""
    try:
        while udp_socket.recv(2048):
            pass
    except (BlockingIOError, ConnectionError):
        return
