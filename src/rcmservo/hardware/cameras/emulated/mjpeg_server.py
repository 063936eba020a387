"""A camera on the network that sends one JPEG after the other (Motion JPEG over HTTP), as many
cheap ones do.

Each client gets the newest frame when it has taken the one before: a client that stalls misses
frames, keeps nobody waiting, and is sent away after a while.
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
from rcmservo.ports import refusal

HOST = "127.0.0.1"
QUALITY = 92
"""Of the JPEGs, up to 100."""
BOUNDARY = "frame"
LOOK = 0.001
"""s between looks at the camera."""
WAIT = 0.5
"""s for which a client's thread waits for a frame before it looks whether all is over."""
STALLED = 5.0
"""s after which a client that takes nothing is sent away."""
KEPT = 1 << 18
"""Bytes on their way to a client: a few frames, so that it is not sent old ones."""


class MjpegServer:
    """Offers the frames of a camera on a port of this computer (0: one that is free)."""

    def __init__(self, camera: Camera, port: int) -> None:
        self._camera = camera
        self._new = threading.Condition()
        self._count, self._jpeg, self._waiting, self._over = 0, b"", 0, False
        try:
            self._http = _Server((HOST, port), partial(_Client, self))
        except OSError as error:
            raise RcmServoError(refusal(port, error)) from error
        self.port = int(self._http.server_address[1])
        works = self._http.serve_forever, self._encode
        self._threads = [threading.Thread(target=work, daemon=True) for work in works]
        for thread in self._threads:
            thread.start()

    @property
    def address(self) -> str:
        """Where it is."""
        return f"http://{HOST}:{self.port}/"

    def newer(self, count: int) -> tuple[int, bytes]:
        """Count and JPEG of the newest frame, once it is newer than that count; without one where
        none comes."""
        with self._new:
            self._waiting += 1
            self._new.wait_for(lambda: self._count > count or self._over, WAIT)
            self._waiting -= 1
            return (self._count, self._jpeg) if self._count > count else (count, b"")

    @property
    def over(self) -> bool:
        """Whether clients are to be sent away."""
        return self._over

    def close(self) -> None:
        """Send all clients away."""
        self._over = True
        self._http.shutdown()
        self._http.server_close()
        for thread in self._threads:
            thread.join()

    def _encode(self) -> None:
        """Encode each new frame for which somebody waits."""
        last: Frame | None = None
        while not self._over:
            frame = self._camera.latest() if self._waiting else None
            if frame is None or frame is last or frame.image is None:
                time.sleep(LOOK)
                continue
            last = frame
            jpeg = encoded(frame.image)
            with self._new:
                self._count, self._jpeg = self._count + 1, jpeg
                self._new.notify_all()


def encoded(image: Any) -> bytes:
    """A picture as JPEG."""
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return np.asarray(jpeg).tobytes()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that is gone is nothing to tell."""


class _Client(BaseHTTPRequestHandler):
    """One that asks for the frames, on a thread of its own."""

    def __init__(self, server: MjpegServer, *arguments: Any) -> None:
        self._frames = server
        super().__init__(*arguments)

    def setup(self) -> None:
        self.request.settimeout(STALLED)
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KEPT)
        super().setup()

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        count = 0
        while not self._frames.over:
            count, jpeg = self._frames.newer(count)
            if jpeg:
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                start = f"--{BOUNDARY}\r\n{head}".encode()
                self.wfile.write(start + jpeg + b"\r\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Nobody reads it."""
