"""Driver of the toy arm: an example of an `Arm`.

    arm = UdpArm("127.0.0.1", 5600)

A thread communicates with the device, so that the loop never waits for it.
"""

import secrets
import socket
import threading
import time
from contextlib import suppress

import numpy as np
from toy_wire import ASK, ENABLE, JOG, OFF, WHYS, ToyAnswer, ToyOrder, answer_in, sent

import rcmservo as rs

POLL_PERIOD_S = 0.004
"""Time (s) between two requests."""

MAX_ROUND_TRIP_NS = 10_000_000
"""Longest round trip (ns) of an answer; longer ones leave the time of the joints too uncertain."""

TIMEOUT_S = 1.0
"""Time (s) for the first answer, and for switching the drive on."""

REST = 0.0, 0.0, 0.0


class NoToy(rs.RcmServoError):
    """Raised if the toy arm cannot be used."""


class UdpArm:
    """Connected toy arm; `close` it at the end."""

    def __init__(self, address: str, port: int) -> None:
        self._wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._wire.connect((address, port))
        self._wire.settimeout(POLL_PERIOD_S)
        self._session, self._over, self._new = 0, False, threading.Event()
        self._last: tuple[int, ToyAnswer] | None = None
        self._thread = threading.Thread(target=self._talk, name="udp-arm", daemon=True)
        self._thread.start()
        if not self._new.wait(TIMEOUT_S):
            self.close()
            raise NoToy(f"no toy arm answers at {address}:{port} within {TIMEOUT_S:g} s")

    def enable(self) -> None:
        """Start a session of this host only, and switch the drive on."""
        self._session = secrets.randbits(32) or 1
        end = time.monotonic() + TIMEOUT_S
        while not self.measure().enabled:
            if time.monotonic() > end:
                why = "another host uses it" if self._last[1].on else "it does not answer"
                raise NoToy(f"the toy arm cannot be switched on: {why}")
            self._send(ENABLE)
            self._new.clear()
            self._new.wait(2 * POLL_PERIOD_S)

    def measure(self) -> rs.ArmMeasurement:
        """Return the last answer without waiting; the drive counts as on in this session only."""
        at, answer = self._last
        mine = answer.on and answer.session == self._session
        return rs.ArmMeasurement(at, np.array(answer.q), mine)

    def apply(self, command: rs.Command) -> np.ndarray:
        """Send a command, unless its deadline has passed: then the watchdog stops the toy."""
        if not command.enabled:
            self._send(OFF)
        elif time.monotonic_ns() <= command.deadline:
            self._send(JOG, command.number + 1, tuple(command.rates.tolist()))
        return np.array(self._last[1].rates if self.measure().enabled else REST)

    @property
    def off_reason(self) -> str:
        """Reason why the drive switched off, as text; empty if it is on or never was."""
        return WHYS[self._last[1].why]

    def close(self) -> None:
        """Switch the drive off if this host uses it, and disconnect."""
        self._over = True
        self._thread.join()
        if self._last is not None and self.measure().enabled:
            self._send(OFF)
        self._wire.close()

    def _send(self, kind: int, number: int = 0, rates: tuple[float, ...] = REST) -> None:
        """Send an order; a lost one is harmless, because the watchdog stops the toy."""
        order = ToyOrder(kind, self._session, number, time.monotonic_ns(), rates)
        with suppress(OSError):
            self._wire.send(sent(order))

    def _talk(self) -> None:
        """Send requests and process answers until `close`."""
        request_time = 0.0
        while not self._over:
            if time.monotonic() > request_time + POLL_PERIOD_S:
                request_time = time.monotonic()
                self._send(ASK)
            try:
                self._take(self._wire.recv(512))
            except TimeoutError:
                continue
            except OSError:  # the device is absent; the age of its last answer reveals it
                time.sleep(POLL_PERIOD_S)

    def _take(self, datagram: bytes) -> None:
        """Store an answer if its round trip is short and it is newer than the last one.

        The joints were read between the request and now.
        """
        answer, now = answer_in(datagram), time.monotonic_ns()
        if answer is None or not 0 <= now - answer.stamp <= MAX_ROUND_TRIP_NS:
            return
        at = (answer.stamp + now) // 2
        if self._last is None or at > self._last[0]:
            self._last = at, answer
            self._new.set()
