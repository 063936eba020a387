"""The emulated controller's serial port: one end of a pseudo-terminal, of which a client opens the
other as it would open a real port."""

import os
import tty


class SerialPort:
    """What a server reads and writes like a socket; ``path`` is for the client."""

    def __init__(self) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)

    def fileno(self) -> int:
        """What `select` waits for."""
        return self._ours

    def recv(self, count: int) -> bytes:
        """What a client has sent; BlockingIOError where it has sent nothing."""
        return os.read(self._ours, count)

    def sendall(self, data: bytes) -> None:
        """Send to whoever has the other end open."""
        os.write(self._ours, data)

    def close(self) -> None:
        """No more of it."""
        os.close(self._ours)
        os.close(self._theirs)
