"""Serial port of the emulated controller: a pseudo-terminal that clients open as a port."""

import os
import tty


class SerialPort:
    """Server end of a pseudo-terminal, with the socket methods that the server needs.

    ``path`` is the device that a client opens.
    """

    def __init__(self) -> None:
        self._server_end, self._client_end = os.openpty()
        tty.setraw(self._client_end)
        os.set_blocking(self._server_end, False)
        self.path = os.ttyname(self._client_end)

    def fileno(self) -> int:
        """Return the file descriptor for `select`."""
        return self._server_end

    def recv(self, count: int) -> bytes:
        """Return bytes from the client, or raise BlockingIOError if there are none."""
        return os.read(self._server_end, count)

    def sendall(self, data: bytes) -> None:
        """Send bytes to the client."""
        os.write(self._server_end, data)

    def close(self) -> None:
        """Close both ends."""
        os.close(self._server_end)
        os.close(self._client_end)
