"""The emulated controller on the network: eight handles on one port, by TCP or UDP, and a serial
port where that is asked for.

A ninth host is sent away. Source: command reference, TH and IH.
"""

import contextlib
import random
import select
import socket
import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from rcmservo.errors import RcmServoError
from rcmservo.hardware.galil.emulator.controller import SAMPLE, SERIAL, TCP, UDP, Controller
from rcmservo.hardware.galil.emulator.faults import LATE, Fault
from rcmservo.hardware.galil.emulator.serial_port import SerialPort
from rcmservo.ports import refusal

PACKET = 1024
"""Bytes that are read in one go."""
HOST = "127.0.0.1"
MOST_AT_ONCE = 512
"""Samples that are made up for in one go."""


class NoPort(RcmServoError):
    """A port that cannot be listened on."""


@dataclass
class Peer:
    """A host that is connected."""

    wire: socket.socket | SerialPort
    """Its connection; the common one of UDP."""
    address: tuple[str, int] | None = None
    """Where to send to by UDP."""
    late: deque[tuple[float, bytes]] = field(default_factory=deque[tuple[float, bytes]])
    """Answers, and when they go out."""


class Server:
    """Offers a controller to hosts; `turn` does all that is due."""

    def __init__(
        self,
        controller: Controller,
        port: int,
        faults: Sequence[Fault] = (),
        serial: SerialPort | None = None,
    ) -> None:
        self.controller, self.faults, self._serial = controller, faults, serial
        self._peers: dict[int, Peer] = {}
        self._random = random.Random(0)
        self._seconds, self._samples, self._was_reset = 0.0, 0, False
        self._listening = _bound(socket.SOCK_STREAM, port)
        self.port = int(self._listening.getsockname()[1])
        self._datagrams = _bound(socket.SOCK_DGRAM, self.port)
        self._listening.listen(16)
        self._listening.setblocking(False)
        self._datagrams.setblocking(False)
        self._plug_in()

    def close(self) -> None:
        """Let all hosts go."""
        for peer in self._peers.values():
            peer.wire.close()
        self._listening.close()
        self._datagrams.close()

    def wait(self, seconds: float) -> None:
        """Until a host says something, at most so long."""
        wires = [peer.wire for peer in self._peers.values()]
        heard = [self._listening, self._datagrams, *wires]
        select.select([] if self._acting("silence") else heard, [], [], max(seconds, 0.0))

    def turn(self, seconds: float) -> None:
        """Let time pass up to `seconds` after the start, and hear and answer all hosts."""
        self._seconds = seconds
        self.controller.stuck = 0 if self._acting("stuck") else None
        self.controller.unpowered = self._acting("amplifier")
        self._catch_up(int(seconds / SAMPLE))
        self._reset_if_due()
        if not self._acting("silence"):
            self._accept()
            self._hear_datagrams()
            for handle in list(self._peers):
                self._hear(handle)
        for handle in list(self._peers):
            self._answer(handle)

    def _acting(self, kind: str) -> bool:
        return any(fault.kind == kind and fault.acts(self._seconds) for fault in self.faults)

    def _catch_up(self, due: int) -> None:
        self._samples = max(self._samples, due - MOST_AT_ONCE)
        while self._samples < due:
            self._samples += 1
            self.controller.sample()

    def _reset_if_due(self) -> None:
        acts = self._acting("reset")
        if acts and not self._was_reset:
            self.controller.reset()
        self._was_reset = acts

    def _plug_in(self) -> None:
        """The serial cable is always there, also behind a reset."""
        if self._serial is not None and SERIAL not in self.controller.lines:
            self.controller.connect_serial()
            self._peers[SERIAL] = Peer(self._serial)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                wire, _ = self._listening.accept()
                handle = self.controller.connect(TCP)
                if handle is None:
                    linger = struct.pack("ii", 1, 0)
                    wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
                    wire.close()
                    continue
                wire.setblocking(False)
                wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._peers[handle] = Peer(wire)

    def _hear_datagrams(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data, address = self._datagrams.recvfrom(PACKET)
                handle = self._of(address)
                if handle is not None:
                    self.controller.hear(handle, data)

    def _of(self, address: tuple[str, int]) -> int | None:
        for handle, peer in self._peers.items():
            if peer.address == address:
                return handle
        handle = self.controller.connect(UDP)
        if handle is not None:
            self._peers[handle] = Peer(self._datagrams, address)
        return handle

    def _hear(self, handle: int) -> None:
        peer = self._peers[handle]
        if peer.address is not None or handle not in self.controller.lines:
            return
        try:
            data = peer.wire.recv(PACKET)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self.controller.hear(handle, data)
        else:
            self._drop(handle)

    def _answer(self, handle: int) -> None:
        if handle not in self.controller.lines:
            self._drop(handle)
            self._plug_in()
            return
        peer = self._peers[handle]
        told = self._damaged(self.controller.answers(handle))
        if told:
            after = LATE if self._acting("slow") else 0.0
            peer.late.append((self._seconds + after, told))
        while peer.late and peer.late[0][0] <= self._seconds:
            self._send(handle, peer, peer.late.popleft()[1])

    def _damaged(self, told: bytes) -> bytes:
        if told and self._acting("garbage"):
            return self._random.randbytes(self._random.randint(1, 64))
        return told[: len(told) // 2] if self._acting("half") else told

    def _send(self, handle: int, peer: Peer, told: bytes) -> None:
        try:
            if peer.address is not None:
                self._datagrams.sendto(told, peer.address)
            else:
                peer.wire.sendall(told)
        except BlockingIOError:  # a host that reads nothing: what it misses is lost
            return
        except OSError:
            self._drop(handle)

    def _drop(self, handle: int) -> None:
        peer = self._peers.pop(handle)
        self.controller.disconnect(handle)
        if peer.address is None and handle != SERIAL:
            peer.wire.close()


def _bound(kind: socket.SocketKind, port: int) -> socket.socket:
    wire = socket.socket(socket.AF_INET, kind)
    if kind is socket.SOCK_STREAM:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        wire.bind((HOST, port))
    except OSError as error:
        wire.close()
        raise NoPort(refusal(port, error)) from error
    return wire
