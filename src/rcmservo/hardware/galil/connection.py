"""Connection to a Galil controller: command lines and replies, with one prompt per command.

The controller answers each command of a line with its data and a colon, or with a question mark if
it refuses the command. A client that reads more or fewer prompts than it has sent commands assigns
the next reply to the wrong command. A late or surplus reply therefore closes the connection for
good. Unsolicited messages of the controller arrive over a second connection.

Sources: command reference, Communications; motorapp/Galil, GalilConnector.cpp.
"""

import contextlib
import re
import secrets
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from rcmservo.errors import NotInstalled, RcmServoError, quote_value, shorten_to_line
from rcmservo.hardware.galil.data_record import DataRecord, decode_record, record_size

MAX_LINE_LENGTH = 80
"""Characters of a line that the controller reads."""
MAX_NUMBER = 2.0**31
"""Largest absolute value of the controller's numbers."""
MAX_REPLY_BYTES = 1 << 20
"""Size limit of one reply, larger than the longest program."""
LINE_END = b"\r"
PROMPT = re.compile(rb"[:?]")
"""End of a reply: a colon for an accepted command, a question mark for a refused one."""

DOWNLOAD_REFUSAL_WAIT_S = 0.1
"""Time to wait for the refusal of a download. An accepted download has no reply before its end."""

SERIAL_SYNC_S = 1.0
"""Time in which a controller at a serial port finishes its replies to earlier commands."""

UNSOLICITED_BIT = 0x80
"""Bit that is set in each byte of an unsolicited message (CW 1)."""


class ConnectionLost(RcmServoError):
    """Error of a controller that does not reply as expected. The connection is closed."""


class CommandRejected(RcmServoError):
    """Error of a command that the controller has refused."""


class ByteStream(Protocol):
    """Bytes to and from a device."""

    def send(self, data: bytes) -> None:
        """Send all bytes."""
        ...

    def receive(self, seconds: float) -> bytes:
        """Return the bytes received within some seconds, empty if there are none.

        Raises
        ------
        OSError
            If the stream is closed.
        """
        ...

    def close(self) -> None:
        """Close the stream."""
        ...


class TcpStream:
    """TCP connection to a controller.

    Parameters
    ----------
    host : str
        Name or address of the controller.
    port : int
        TCP port.
    timeout_s : float
        Time limit of connecting and of sending, s.

    Raises
    ------
    ConnectionLost
        If the controller is not reachable.
    """

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConnectionLost(f"{host}:{port} cannot be reached: {reason}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._timeout_s = timeout_s

    def send(self, data: bytes) -> None:
        self._socket.settimeout(self._timeout_s)
        self._socket.sendall(data)

    def receive(self, seconds: float) -> bytes:
        self._socket.settimeout(max(seconds, 0.0))
        try:
            data = self._socket.recv(4096)
        except (TimeoutError, BlockingIOError):
            return b""
        if not data:
            raise ConnectionResetError("the controller has closed the connection")
        return data

    def close(self) -> None:
        self._socket.close()


class SerialStream:
    """Serial connection to a controller, with the controller's echo switched off.

    Parameters
    ----------
    port : str
        Path or name of the port.
    baud : int
        Bit rate in bits/s.
    timeout_s : float
        Time limit of a reply, s.

    Raises
    ------
    ConnectionLost
        If the port cannot be opened, or no controller answers there.
    """

    def __init__(self, port: str, baud: int, timeout_s: float) -> None:
        try:
            import serial
        except ImportError as error:
            missing = NotInstalled("a serial port", "pyserial", "hardware")
            raise ConnectionLost(f"{port} cannot be opened: {missing}") from error
        self._serial_error = serial.SerialException
        try:
            self._port: Any = serial.Serial(port, baud)
        except (self._serial_error, ValueError) as error:
            raise ConnectionLost(f"{port} cannot be opened: {shorten_to_line(error)}") from error
        try:
            self._synchronise(f"rcm{secrets.token_hex(4)}".encode(), timeout_s)
        except OSError as error:
            raise ConnectionLost(f"{port} cannot be used: {shorten_to_line(error)}") from error

    def _synchronise(self, token: bytes, timeout_s: float) -> None:
        """Discard replies to earlier commands, up to the reply that contains a new token.

        An earlier client may have left an incomplete line, which the first line end completes. The
        echo of the MG line is no reply: it has quotes around the token.
        """
        for line in (b"EO 0", b"EO 0", b'MG "' + token + b'"'):
            self.send(line + LINE_END)
        received, deadline = b"", time.monotonic() + SERIAL_SYNC_S + timeout_s
        while not received.endswith(token + b"\r\n:"):
            if time.monotonic() > deadline or len(received) > MAX_REPLY_BYTES:
                self.close()
                raise OSError("no Galil controller answers there: check port and baud")
            received += self.receive(timeout_s)

    def send(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except self._serial_error as error:
            raise ConnectionError(str(error)) from error

    def receive(self, seconds: float) -> bytes:
        try:
            self._port.timeout = max(seconds, 0.0)
            first_byte = self._port.read(1)
            return first_byte + self._port.read(self._port.in_waiting) if first_byte else b""
        except (self._serial_error, TypeError) as error:  # TypeError: another thread closed it
            raise ConnectionError(str(error)) from error

    def close(self) -> None:
        self._port.close()


class GalilConnection:
    """Commands to a controller, one line at a time, each with its replies.

    Parameters
    ----------
    stream : ByteStream
        Bytes to and from the controller.
    timeout_s : float
        Time limit of a reply, s.
    now : callable
        Function that returns the present time in s.
    """

    def __init__(
        self, stream: ByteStream, timeout_s: float, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.now = now
        self._stream, self._timeout_s = stream, timeout_s
        self._received = bytearray()

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._stream.close()

    def execute(self, *commands: str) -> list[str]:
        """Send commands in one line and return the reply to each.

        Raises
        ------
        CommandRejected
            If the controller refuses a command; with the controller's reason.
        ConnectionLost
            If the replies are late, incomplete or too many.
        """
        self._send_line(";".join(commands))
        replies = [self._read_reply() for _ in commands]
        self._require_no_surplus(commands)
        for command, reply in zip(commands, replies, strict=True):
            if reply is None:
                raise self._read_rejection(command)
        return [reply for reply in replies if reply is not None]

    def read_number(self, expression: str) -> float:
        """Read the value of an expression."""
        return self.read_numbers(f"MG {expression}")[0]

    def read_variable(self, name: str) -> float:
        """Read a variable, 0 if the controller has none of this name."""
        try:
            return self.read_number(name)
        except CommandRejected:
            return 0.0

    def read_numbers(self, *commands: str) -> list[float]:
        """Send commands and return the numbers, at least one, in the reply to the last."""
        reply = self.execute(*commands)[-1]
        try:
            values = [float(part) for part in reply.split()]
        except ValueError:
            values = []
        if not values or not all(abs(value) <= MAX_NUMBER for value in values):
            raise self._close_as_lost(
                f"{commands[-1]} must return numbers, got {quote_value(reply)}"
            )
        return values

    def read_data_record(self, axis_count: int, *commands: str) -> DataRecord:
        """Send commands without reply data, and return the data record that follows them."""
        self._send_line(";".join((*commands, "QR")))
        replies = [self._read_reply() for _ in commands]
        data = self._read_bytes(record_size(axis_count) + 1)
        self._require_no_surplus(commands)
        if None in replies:
            raise self._read_rejection(commands[replies.index(None)])
        if not data.endswith(b":"):
            raise self._close_as_lost("a data record must end with a colon")
        return decode_record(data[:-1], axis_count)

    def read_messages(self) -> list[str]:
        """Return the unsolicited messages received so far, without waiting.

        For a connection on which no commands are sent. An incomplete line stays in the buffer.
        """
        self._receive(0.0)
        unmarked = bytes(byte & ~UNSOLICITED_BIT for byte in self._received)
        *lines, incomplete_line = unmarked.split(b"\n")
        self._received = bytearray(incomplete_line[-MAX_LINE_LENGTH:])
        messages = (shorten_to_line(line.decode("ascii", "replace")) for line in lines)
        return [message for message in messages if message]

    def download_program(self, lines: list[str]) -> None:
        """Replace the program in the controller's memory.

        The motors must be off: the controller refuses a line before the end of the download, and it
        executes lines that arrive after the refusal as commands.
        """
        self._send_line("DL")
        self._receive(min(DOWNLOAD_REFUSAL_WAIT_S, self._timeout_s))
        self._require_no_refusal("DL")
        for line in lines:
            self._send_line(line)
            self._receive(0.0)
            self._require_no_refusal(line)
        self._send_line("\\")
        replies = [self._read_reply() for _ in range(2)]
        if None in replies:
            raise self._read_download_rejection("DL")
        self._require_no_surplus(("DL",))

    def _require_no_refusal(self, line: str) -> None:
        if self._received.startswith(b"?"):
            raise self._read_download_rejection(line)

    def _read_download_rejection(self, line: str) -> CommandRejected:
        """Return the error, after discarding replies to lines that were executed as commands."""
        deadline = self.now() + self._timeout_s
        while self.now() < deadline:
            self._receive(deadline - self.now())
            self._received.clear()
        return self._read_rejection(line)

    def _send_line(self, line: str) -> None:
        if len(line) > MAX_LINE_LENGTH:
            raise ValueError(f"a line of {len(line)} characters: {line}")
        try:
            self._stream.send(line.encode("ascii") + LINE_END)
        except OSError as error:
            raise self._close_as_lost(error.strerror or str(error)) from error

    def _read_reply(self) -> str | None:
        """Read the reply to one command, None if the controller has refused it."""
        deadline = self.now() + self._timeout_s
        while not (match := PROMPT.search(self._received)):
            self._wait_for_data(deadline)
        data, prompt = bytes(self._received[: match.start()]), match.group()
        del self._received[: match.end()]
        return None if prompt == b"?" else data.decode("latin-1").strip()

    def _read_bytes(self, count: int) -> bytes:
        deadline = self.now() + self._timeout_s
        while len(self._received) < count:
            if self._received.startswith(b"?"):
                raise self._close_as_lost("QR was refused")
            self._wait_for_data(deadline)
        data = bytes(self._received[:count])
        del self._received[:count]
        return data

    def _wait_for_data(self, deadline: float) -> None:
        remaining_s = deadline - self.now()
        if remaining_s <= 0.0:
            raise self._close_as_lost(f"it has not answered for {self._timeout_s:g} s")
        if len(self._received) > MAX_REPLY_BYTES:
            raise self._close_as_lost("its reply has no end")
        self._receive(remaining_s)

    def _receive(self, seconds: float) -> None:
        try:
            self._received += self._stream.receive(seconds)
        except OSError as error:
            raise self._close_as_lost(error.strerror or str(error)) from error

    def _require_no_surplus(self, commands: tuple[str, ...]) -> None:
        if self._received:
            surplus = quote_value(bytes(self._received[:20]))
            line = ";".join(commands)
            raise self._close_as_lost(f"it replied more than {line} requests: {surplus}")

    def _read_rejection(self, command: str) -> CommandRejected:
        """Return the error of a refused command, with the reason that TC1 reports."""
        self._send_line("TC1")
        reply = self._read_reply()
        reason = shorten_to_line(reply) if reply else "it gives no reason"
        return CommandRejected(f"the controller refused {command!r}: {reason}")

    def _close_as_lost(self, reason: str) -> ConnectionLost:
        """Close the connection and return the error to raise."""
        self.close()
        return ConnectionLost(f"the controller is lost: {reason}")
