"""Network server of the emulated controller.

It has eight handles over TCP or UDP on one port, and an optional serial port. A ninth host is
disconnected. Source: command reference, TH and IH.
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
from rcmservo.hardware.galil.emulator.controller import (
    SAMPLE_TIME_S,
    SERIAL,
    TCP,
    UDP,
    GalilController,
)
from rcmservo.hardware.galil.emulator.faults import SLOW_REPLY_DELAY_S, Fault
from rcmservo.hardware.galil.emulator.serial_port import SerialPort
from rcmservo.network_ports import describe_refusal

MAX_READ_BYTES = 1024
"""Bytes of one read from a host."""
LOOPBACK = "127.0.0.1"
RESET_ON_CLOSE = struct.pack("ii", 1, 0)
"""Value of the socket option SO_LINGER with which `close` resets the connection."""
MAX_CATCH_UP_SAMPLES = 512
"""Samples that one update makes up for after a delay."""


class PortUnavailable(RcmServoError):
    """Error of a port on which the server cannot listen."""


@dataclass
class Peer:
    """Connected host.

    Parameters
    ----------
    stream : socket.socket or SerialPort
        Its connection; for UDP the server's common socket.
    address : tuple[str, int] or None
        UDP address of the host; None for TCP and the serial port.
    delayed : deque[tuple[float, bytes]]
        Replies with the times (s) at which they are sent.
    """

    stream: socket.socket | SerialPort
    address: tuple[str, int] | None = None
    delayed: deque[tuple[float, bytes]] = field(default_factory=deque[tuple[float, bytes]])


class GalilServer:
    """Server that connects hosts to an emulated controller. `update` does all work that is due.

    Parameters
    ----------
    controller : Controller
        Emulated controller.
    port : int
        Port for TCP and UDP; 0 selects a free one.
    faults : sequence of Fault
        Faults with their times.
    serial : SerialPort or None
        Additional serial port.

    Raises
    ------
    PortUnavailable
        If the port is in use or not permitted.
    """

    def __init__(
        self,
        controller: GalilController,
        port: int,
        faults: Sequence[Fault] = (),
        serial: SerialPort | None = None,
    ) -> None:
        self.controller, self.faults, self._serial = controller, faults, serial
        self._peers: dict[int, Peer] = {}
        self._random = random.Random(0)
        self._time_s, self._sample_count, self._has_reset_fault = 0.0, 0, False
        self._listener = _bind(socket.SOCK_STREAM, port)
        self.port = int(self._listener.getsockname()[1])
        self._udp_socket = _bind(socket.SOCK_DGRAM, self.port)
        self._listener.listen(16)
        self._connect_serial()

    def close(self) -> None:
        """Disconnect all hosts."""
        for peer in self._peers.values():
            peer.stream.close()
        self._listener.close()
        self._udp_socket.close()

    def wait(self, seconds: float) -> None:
        """Wait until a host sends something, at most some seconds."""
        peer_streams = (peer.stream for peer in self._peers.values())
        streams = [self._listener, self._udp_socket, *peer_streams]
        select.select([] if self._has_fault("silence") else streams, [], [], max(seconds, 0.0))

    def update(self, seconds: float) -> None:
        """Advance to a time (s after the start), read from all hosts and reply to them."""
        self._time_s = seconds
        self.controller.stuck = 0 if self._has_fault("stuck") else None
        self.controller.unpowered = self._has_fault("amplifier")
        self._advance_to_sample(int(seconds / SAMPLE_TIME_S))
        self._reset_if_due()
        if not self._has_fault("silence"):
            self._accept_hosts()
            self._receive_datagrams()
            for handle in list(self._peers):
                self._receive(handle)
        for handle in list(self._peers):
            self._send_output(handle)

    def _has_fault(self, kind: str) -> bool:
        return any(fault.kind == kind and fault.is_active(self._time_s) for fault in self.faults)

    def _advance_to_sample(self, due_count: int) -> None:
        self._sample_count = max(self._sample_count, due_count - MAX_CATCH_UP_SAMPLES)
        while self._sample_count < due_count:
            self._sample_count += 1
            self.controller.sample()

    def _reset_if_due(self) -> None:
        had_reset_fault, self._has_reset_fault = self._has_reset_fault, self._has_fault("reset")
        if self._has_reset_fault and not had_reset_fault:
            self.controller.reset()

    def _connect_serial(self) -> None:
        """Connect the serial port, at the start and after each reset."""
        if self._serial is not None and SERIAL not in self.controller.connections:
            self.controller.connect_serial()
            self._peers[SERIAL] = Peer(self._serial)

    def _accept_hosts(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                stream, _ = self._listener.accept()
                handle = self.controller.connect(TCP)
                if handle is None:
                    stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
                    stream.close()
                    continue
                stream.setblocking(False)
                stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._peers[handle] = Peer(stream)

    def _receive_datagrams(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data, address = self._udp_socket.recvfrom(MAX_READ_BYTES)
                handle = self._find_handle(address)
                if handle is not None:
                    self.controller.receive(handle, data)

    def _find_handle(self, address: tuple[str, int]) -> int | None:
        """Return the handle of a UDP host, which a new host gets here; None if all are in use."""
        for handle, peer in self._peers.items():
            if peer.address == address:
                return handle
        handle = self.controller.connect(UDP)
        if handle is not None:
            self._peers[handle] = Peer(self._udp_socket, address)
        return handle

    def _receive(self, handle: int) -> None:
        peer = self._peers[handle]
        if peer.address is not None or handle not in self.controller.connections:
            return
        try:
            data = peer.stream.recv(MAX_READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self.controller.receive(handle, data)
        else:
            self._drop(handle)

    def _send_output(self, handle: int) -> None:
        if handle not in self.controller.connections:
            self._drop(handle)
            self._connect_serial()
            return
        peer = self._peers[handle]
        output = self._apply_faults(self.controller.take_output(handle))
        if output:
            delay = SLOW_REPLY_DELAY_S if self._has_fault("slow") else 0.0
            peer.delayed.append((self._time_s + delay, output))
        while peer.delayed and peer.delayed[0][0] <= self._time_s:
            self._send(handle, peer, peer.delayed.popleft()[1])

    def _apply_faults(self, output: bytes) -> bytes:
        if output and self._has_fault("garbage"):
            return self._random.randbytes(self._random.randint(1, 64))
        return output[: len(output) // 2] if self._has_fault("half") else output

    def _send(self, handle: int, peer: Peer, data: bytes) -> None:
        try:
            if peer.address is not None:
                self._udp_socket.sendto(data, peer.address)
            else:
                peer.stream.sendall(data)
        except BlockingIOError:  # a host that does not read loses these bytes
            return
        except OSError:
            self._drop(handle)

    def _drop(self, handle: int) -> None:
        peer = self._peers.pop(handle)
        self.controller.disconnect(handle)
        if peer.address is None and handle != SERIAL:
            peer.stream.close()


def _bind(kind: socket.SocketKind, port: int) -> socket.socket:
    """Return a socket bound to a port of the loopback interface, whose calls do not wait."""
    bound_socket = socket.socket(socket.AF_INET, kind)
    bound_socket.setblocking(False)
    if kind is socket.SOCK_STREAM:
        bound_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound_socket.bind((LOOPBACK, port))
    except OSError as error:
        bound_socket.close()
        raise PortUnavailable(describe_refusal(port, error)) from error
    return bound_socket
