"""Emulated network camera that sends Motion JPEG over HTTP, like many inexpensive cameras.

Each client gets the newest frame after it has received the previous one. A client that stalls
misses frames without delaying the others, and is disconnected after a while.
"""

import socket
import threading
import time
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import cv2
import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Camera, Frame
from rcmservo.network_ports import describe_refusal

LOOPBACK = "127.0.0.1"
JPEG_QUALITY = 92
"""JPEG quality, 0 to 100."""
BOUNDARY = "frame"
POLL_PERIOD_S = 0.001
"""Period of the checks for a new frame."""
FRAME_TIMEOUT_S = 0.5
"""Wait of a client's thread for a frame, after which it checks for the end of the server."""
STALL_TIMEOUT_S = 5.0
"""Time without progress after which a client is disconnected."""
SEND_BUFFER_BYTES = 1 << 18
"""Bytes in transit to a client: a few frames, so that it does not get old ones."""


class MjpegServer:
    """HTTP server of a camera's frames.

    Parameters
    ----------
    camera : Camera
        Source of the frames.
    port : int
        TCP port on the loopback interface; 0 selects a free one.

    Raises
    ------
    RcmServoError
        If the port is in use or not permitted.
    """

    def __init__(self, camera: Camera, port: int) -> None:
        self._camera = camera
        self._new_frame = threading.Condition()
        self._count, self._jpeg, self._waiting_clients = 0, b"", 0
        self.is_closing = False
        """True after `close`."""
        try:
            self._server = _Server((LOOPBACK, port), partial(_ClientHandler, self))
        except OSError as error:
            raise RcmServoError(describe_refusal(port, error)) from error
        self.port = int(self._server.server_address[1])
        targets = self._server.serve_forever, self._encode_frames
        self._threads = [threading.Thread(target=target, daemon=True) for target in targets]
        for thread in self._threads:
            thread.start()

    @property
    def address(self) -> str:
        """URL of the stream."""
        return f"http://{LOOPBACK}:{self.port}/"

    def wait_for_newer(self, count: int) -> tuple[int, bytes]:
        """Wait for a frame after frame number `count`; return its number and JPEG.

        If no frame comes, the number is `count` and the JPEG is empty.
        """
        with self._new_frame:
            self._waiting_clients += 1
            self._new_frame.wait_for(
                lambda: self._count > count or self.is_closing, FRAME_TIMEOUT_S
            )
            self._waiting_clients -= 1
            return (self._count, self._jpeg) if self._count > count else (count, b"")

    def close(self) -> None:
        """Disconnect all clients and stop the server."""
        self.is_closing = True
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def _encode_frames(self) -> None:
        """Encode each new frame for which a client waits."""
        encoded_frame: Frame | None = None
        while not self.is_closing:
            frame = self._camera.latest() if self._waiting_clients else None
            if frame is None or frame is encoded_frame or frame.image is None:
                time.sleep(POLL_PERIOD_S)
                continue
            encoded_frame = frame
            jpeg = encode_jpeg(frame.image)
            with self._new_frame:
                self._count, self._jpeg = self._count + 1, jpeg
                self._new_frame.notify_all()


def encode_jpeg(image: Any) -> bytes:
    """Encode an image as JPEG."""
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return np.asarray(jpeg).tobytes()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that has disconnected."""


class _ClientHandler(BaseHTTPRequestHandler):
    """Handler of one client, in a separate thread."""

    def __init__(self, server: MjpegServer, *arguments: Any) -> None:
        self._frames = server
        super().__init__(*arguments)

    def setup(self) -> None:
        self.request.settimeout(STALL_TIMEOUT_S)
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        super().setup()

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        count = 0
        while not self._frames.is_closing:
            count, jpeg = self._frames.wait_for_newer(count)
            if jpeg:
                header = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                self.wfile.write(f"--{BOUNDARY}\r\n{header}".encode() + jpeg + b"\r\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""
