"""Lines to a controller, and its answers: one prompt for every command of a line.

A colon says that a command was taken, a question mark that it was not; what it tells stands before
the colon. Whoever reads more or fewer than one prompt a command takes one answer for another's, so
what does not come in time, or is more than was asked for, ends the conversation for good. What the
controller says of its own accord comes by a connection of its own.

Source: command reference, Communications; motorapp/Galil, GalilConnector.cpp.
"""

import contextlib
import secrets
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from rcmservo.errors import NotInstalled, RcmServoError, one_line, told
from rcmservo.hardware.galil.data_record import DataRecord, size_of, unpacked

LONGEST_LINE = 80
"""Characters that the controller reads of a line."""
GREATEST = 2.0**31
"""No number of its is greater."""
LONGEST_ANSWER = 1 << 20
"""Bytes of one answer, more than the longest program has."""
END = b"\r"

REFUSED_WITHIN = 0.1
"""s for which it is waited whether a download is refused: one that is taken is not answered before
its end."""

BEGIN = 1.0
"""s within which a controller at a serial port has told all that was asked before."""

MARK = 0x80
"""In each byte that the controller says of its own accord, as CW 1 has it."""


class Lost(RcmServoError):
    """A controller that does not answer as it must: the connection is closed."""


class Rejected(RcmServoError):
    """A command that the controller did not take."""


class ByteStream(Protocol):
    """Bytes to and from a device."""

    def send(self, data: bytes) -> None:
        """Send all of it."""
        ...

    def receive(self, seconds: float) -> bytes:
        """What has come, after so many s at most; empty if nothing has. OSError if it is closed."""
        ...

    def close(self) -> None:
        """No more of it."""
        ...


class TcpStream:
    """A connection by network."""

    def __init__(self, host: str, port: int, seconds: float) -> None:
        try:
            self._wire = socket.create_connection((host, port), timeout=seconds)
        except OSError as error:
            words = error.strerror or str(error)
            raise Lost(f"{host}:{port} cannot be reached: {words}") from error
        self._wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._seconds = seconds

    def send(self, data: bytes) -> None:
        self._wire.settimeout(self._seconds)
        self._wire.sendall(data)

    def receive(self, seconds: float) -> bytes:
        self._wire.settimeout(max(seconds, 0.0))
        try:
            data = self._wire.recv(4096)
        except (TimeoutError, BlockingIOError):
            return b""
        if not data:
            raise ConnectionResetError("the controller has closed the connection")
        return data

    def close(self) -> None:
        self._wire.close()


class SerialStream:
    """A connection by a serial port, on which the controller is told not to repeat what it
    hears."""

    def __init__(self, port: str, baud: int, seconds: float) -> None:
        try:
            import serial
        except ImportError as error:
            missing = NotInstalled("a serial port", "pyserial", "hardware")
            raise Lost(f"{port} cannot be opened: {missing}") from error
        self._failed = serial.SerialException
        try:
            self._wire: Any = serial.Serial(port, baud)
        except (self._failed, ValueError) as error:
            raise Lost(f"{port} cannot be opened: {one_line(error)}") from error
        try:
            self._begin_anew(f"rcm{secrets.token_hex(4)}".encode(), seconds)
        except OSError as error:
            raise Lost(f"{port} cannot be used: {one_line(error)}") from error

    def _begin_anew(self, word: bytes, seconds: float) -> None:
        """Have a word come back that nobody has said before: what comes ahead of it answers others.

        Half a line may stand there, which the first end of line ends. What is repeated as it is
        heard is no answer: it has quotes about the word.
        """
        for line in (b"EO 0", b"EO 0", b'MG "' + word + b'"'):
            self.send(line + END)
        heard, end = b"", time.monotonic() + BEGIN + seconds
        while not heard.endswith(word + b"\r\n:"):
            if time.monotonic() > end or len(heard) > LONGEST_ANSWER:
                self.close()
                raise OSError("no Galil controller answers there: look at port and baud")
            heard += self.receive(seconds)

    def send(self, data: bytes) -> None:
        try:
            self._wire.write(data)
        except self._failed as error:
            raise ConnectionError(str(error)) from error

    def receive(self, seconds: float) -> bytes:
        try:
            self._wire.timeout = max(seconds, 0.0)
            first = self._wire.read(1)
            return first + self._wire.read(self._wire.in_waiting) if first else b""
        except (self._failed, TypeError) as error:  # TypeError: of a port that is closed meanwhile
            raise ConnectionError(str(error)) from error

    def close(self) -> None:
        self._wire.close()


class Conversation:
    """Questions to a controller, one after the other."""

    def __init__(
        self, stream: ByteStream, seconds: float, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.now = now
        self._stream, self._seconds = stream, seconds
        self._heard = bytearray()

    def close(self) -> None:
        """No more of it."""
        with contextlib.suppress(OSError):
            self._stream.close()

    def ask(self, *commands: str) -> list[str]:
        """What each command of a line tells, or :class:`Rejected` with the reason."""
        self._send(commands)
        answers = [self._answer() for _ in commands]
        self._at_its_end(commands)
        for command, answer in zip(commands, answers, strict=True):
            if answer is None:
                raise self._rejected(command)
        return [answer for answer in answers if answer is not None]

    def number(self, expression: str) -> float:
        """What an expression is on the controller."""
        return self.numbers(f"MG {expression}")[0]

    def known(self, variable: str) -> float:
        """A variable's value, 0 where there is none."""
        try:
            return self.number(variable)
        except Rejected:
            return 0.0

    def numbers(self, *commands: str) -> list[float]:
        """The numbers that the last command of a line tells, one at least."""
        answer = self.ask(*commands)[-1]
        try:
            values = [float(part) for part in answer.split()]
        except ValueError:
            values = []
        if not values or not all(abs(value) <= GREATEST for value in values):
            raise self._lost(f"{commands[-1]} must tell numbers, got {told(answer)}")
        return values

    def record(self, axes: int, *commands: str) -> DataRecord:
        """Some commands that tell nothing, and the data record behind them."""
        self._send((*commands, "QR"))
        answers = [self._answer() for _ in commands]
        data = self._exactly(size_of(axes) + 1)
        self._at_its_end(commands)
        if None in answers:
            raise self._rejected(commands[answers.index(None)])
        if not data.endswith(b":"):
            raise self._lost("a data record must end with a colon")
        return unpacked(data[:-1], axes)

    def overheard(self) -> list[str]:
        """What it has said of its own accord, where nothing is asked: whole lines, without
        waiting."""
        self._receive(0.0)
        *lines, rest = bytes(byte & ~MARK for byte in self._heard).split(b"\n")
        self._heard = bytearray(rest[-LONGEST_LINE:])
        texts = (one_line(line.decode("ascii", "replace")) for line in lines)
        return [text for text in texts if text]

    def download(self, lines: list[str]) -> None:
        """Put a program in the controller's memory, the one before is gone.

        A line that is refused is told before the end; what followed it would count as commands.
        Some may be under way when it is told: have the motors off.
        """
        self._write("DL")
        self._receive(min(REFUSED_WITHIN, self._seconds))
        self._not_refused("DL")
        for line in lines:
            self._write(line)
            self._receive(0.0)
            self._not_refused(line)
        self._write("\\")
        answers = [self._answer() for _ in range(2)]
        if None in answers:
            raise self._download_rejected("DL")
        self._at_its_end(("DL",))

    def _not_refused(self, line: str) -> None:
        if self._heard.startswith(b"?"):
            raise self._download_rejected(line)

    def _download_rejected(self, line: str) -> Rejected:
        """What answers the commands for which its lines were taken is let pass."""
        end = self.now() + self._seconds
        while self.now() < end:
            self._receive(end - self.now())
            self._heard.clear()
        return self._rejected(line)

    def _send(self, commands: tuple[str, ...]) -> None:
        self._write(";".join(commands))

    def _write(self, line: str) -> None:
        if len(line) > LONGEST_LINE:
            raise ValueError(f"a line of {len(line)} characters: {line}")
        try:
            self._stream.send(line.encode("ascii") + END)
        except OSError as error:
            raise self._lost(error.strerror or str(error)) from error

    def _answer(self) -> str | None:
        """What one command tells, None where it was refused."""
        end = self.now() + self._seconds
        while True:
            places = [at for at in (self._heard.find(b":"), self._heard.find(b"?")) if at >= 0]
            if places:
                at = min(places)
                before, prompt = bytes(self._heard[:at]), self._heard[at]
                del self._heard[: at + 1]
                return None if prompt == ord("?") else before.decode("latin-1").strip()
            self._hear(end)

    def _exactly(self, count: int) -> bytes:
        end = self.now() + self._seconds
        while len(self._heard) < count:
            if self._heard.startswith(b"?"):
                raise self._lost("QR was refused")
            self._hear(end)
        data = bytes(self._heard[:count])
        del self._heard[:count]
        return data

    def _hear(self, end: float) -> None:
        left = end - self.now()
        if left <= 0.0:
            raise self._lost(f"it has not answered for {self._seconds:g} s")
        if len(self._heard) > LONGEST_ANSWER:
            raise self._lost("its answer has no end")
        self._receive(left)

    def _receive(self, seconds: float) -> None:
        try:
            self._heard += self._stream.receive(seconds)
        except OSError as error:
            raise self._lost(error.strerror or str(error)) from error

    def _at_its_end(self, commands: tuple[str, ...]) -> None:
        """Nothing more may have come than was asked for."""
        if self._heard:
            extra = told(bytes(self._heard[:20]))
            raise self._lost(f"it answered more than {';'.join(commands)} asks for: {extra}")

    def _rejected(self, command: str) -> Rejected:
        self._write("TC1")
        why = self._answer()
        words = one_line(why) if why else "it does not say why"
        return Rejected(f"the controller refused {command!r}: {words}")

    def _lost(self, why: str) -> Lost:
        self.close()
        return Lost(f"the controller is lost: {why}")
