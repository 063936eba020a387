"""The driver of the toy arm: an `Arm` to copy for one of your own.

    arm = UdpArm("127.0.0.1", 5600)

A thread talks with the device, so that the loop never waits for it.
"""

import secrets
import socket
import threading
import time
from contextlib import suppress

import numpy as np
from toy_wire import ASK, ENABLE, JOG, OFF, WHYS, ToyAnswer, ToyOrder, answer_in, sent

import rcmservo as rs
from rcmservo.errors import RcmServoError

EVERY = 0.004
"""s between two questions."""

SLOW = 10_000_000
"""ns. An answer that took longer does not tell well enough when the joints were read."""

PATIENCE = 1.0
"""s within which it answers the first time, and is on."""

REST = 0.0, 0.0, 0.0


class NoToy(RcmServoError):
    """A toy arm that cannot be used."""


class UdpArm:
    """A toy arm, connected; `close` it at the end."""

    def __init__(self, address: str, port: int) -> None:
        self._wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._wire.connect((address, port))
        self._wire.settimeout(EVERY)
        self._session, self._over, self._new = 0, False, threading.Event()
        self._last: tuple[int, ToyAnswer] | None = None
        self._thread = threading.Thread(target=self._talk, name="udp-arm", daemon=True)
        self._thread.start()
        if not self._new.wait(PATIENCE):
            self.close()
            raise NoToy(f"no toy arm answers at {address}:{port} within {PATIENCE:g} s")

    def enable(self) -> None:
        """Take the toy for this host alone, and switch its drive on."""
        self._session = secrets.randbits(32) or 1
        end = time.monotonic() + PATIENCE
        while not self.measure().enabled:
            if time.monotonic() > end:
                why = "another host has it" if self._last[1].on else "it does not answer"
                raise NoToy(f"the toy arm cannot be switched on: {why}")
            self._send(ENABLE)
            self._new.clear()
            self._new.wait(2 * EVERY)

    def measure(self) -> rs.Measured:
        """The last answer, at once; its drive is on for us only in our own session."""
        at, answer = self._last
        mine = answer.on and answer.session == self._session
        return rs.Measured(at, np.array(answer.q), mine)

    def apply(self, command: rs.Command) -> np.ndarray:
        """Pass a command on. One whose time has passed is not sent: the watchdog stops the toy."""
        if not command.enabled:
            self._send(OFF)
        elif time.monotonic_ns() <= command.deadline:
            self._send(JOG, command.number + 1, tuple(command.rates.tolist()))
        return np.array(self._last[1].rates if self.measure().enabled else REST)

    @property
    def why_off(self) -> str:
        """Why the drive is off, in words; empty where it is on or was not."""
        return WHYS[self._last[1].why]

    def close(self) -> None:
        """Switch it off, if we have it, and hang up."""
        self._over = True
        self._thread.join()
        if self._last is not None and self.measure().enabled:
            self._send(OFF)
        self._wire.close()

    def _send(self, kind: int, number: int = 0, rates: tuple[float, ...] = REST) -> None:
        """What cannot be sent is lost, as any datagram may be; the toy's watchdog sees to it."""
        order = ToyOrder(kind, self._session, number, time.monotonic_ns(), rates)
        with suppress(OSError):
            self._wire.send(sent(order))

    def _talk(self) -> None:
        """Ask, and take what is answered, until it is over."""
        asked = 0.0
        while not self._over:
            if time.monotonic() > asked + EVERY:
                asked = time.monotonic()
                self._send(ASK)
            try:
                self._take(self._wire.recv(512))
            except TimeoutError:
                continue
            except OSError:  # nobody is there now: its silence tells
                time.sleep(EVERY)

    def _take(self, datagram: bytes) -> None:
        """The joints were read between asking and now: neither long ago, nor out of order."""
        answer, now = answer_in(datagram), time.monotonic_ns()
        if answer is None or not 0 <= now - answer.stamp <= SLOW:
            return
        at = (answer.stamp + now) // 2
        if self._last is None or at > self._last[0]:
            self._last = at, answer
            self._new.set()
