"""Simulated toy arm in a separate process, with the safety rules that hardware should have.

    python examples/udp_arm/toy_arm.py --port 5600

The arm is kinematics only: three joints follow their commanded rates with a small lag. `ToyArm`
implements all rules, without a socket and with the time as an argument; docs/own_devices.md
explains the purpose of each rule.
"""

import argparse
import contextlib
import math
import select
import signal
import socket
import time

from toy_wire import ENABLE, JOG, OFF, ToyAnswer, ToyOrder, order_in, sent

LOWER, UPPER = (-1.2, -1.2, 60.0), (1.2, 1.2, 220.0)
"""Joint limits in rad, rad, mm."""

MAX_RATES = 1.0, 1.0, 100.0
"""Largest joint rates in rad/s, rad/s, mm/s."""

LAG = 0.015
"""Time constant (s) with which the joints follow their rates."""

WATCHDOG_TIMEOUT_NS = 50_000_000
"""Time (ns) without a command after which the arm stops by itself."""

OFF_BY_COMMAND, OFF_BY_WATCHDOG = 1, 2
"""Codes of the reasons why the drive is off, indices of `toy_wire.WHYS`."""

START = 0.6, 0.2, 120.0


class ToyArm:
    """State and rules of the device; times are in ns of its own clock."""

    def __init__(self, now: int) -> None:
        self.q, self.rates, self.moving = list(START), [0.0] * 3, [0.0] * 3
        self.on, self.why = False, 0
        self.session, self.number, self.had = 0, 0, {0}
        self.time = self.heard = now

    def hear(self, datagram: bytes, now: int) -> bytes | None:
        """Execute the order in a datagram if it is permitted, and return the answer.

        Damaged datagrams are dropped.
        """
        order = order_in(datagram)
        if order is None:
            return None
        self.advance(now)
        if order.kind == ENABLE and not self.on and order.session not in self.had:
            self.had.add(order.session)
            self.on, self.why, self.session, self.number = True, 0, order.session, 0
            self.heard = now
        elif order.kind == OFF:
            self._off(OFF_BY_COMMAND)
        elif order.kind == JOG and self._may_move(order):
            self.number, self.heard = order.number, now
            self.rates = [
                min(max(rate, -most), most)
                for rate, most in zip(order.rates, MAX_RATES, strict=True)
            ]
            self._keep_within()
        return sent(self._answer(order.stamp))

    def _may_move(self, order: ToyOrder) -> bool:
        """Return whether an order is of the present session and newer than all before."""
        return self.on and order.session == self.session and order.number > self.number

    def advance(self, now: int) -> None:
        """Advance the time; the motion ends when the watchdog expires, even if that was earlier."""
        end = self.heard + WATCHDOG_TIMEOUT_NS
        if self.on and now > end:
            self._move(end - self.time)
            self._off(OFF_BY_WATCHDOG)
        elif self.on:
            self._move(now - self.time)
        self.time = now

    def _off(self, why: int) -> None:
        """Switch the drive off and the brakes on: the joints are at rest."""
        if self.on:
            self.on, self.why = False, why
        self.rates, self.moving = [0.0] * 3, [0.0] * 3

    def _move(self, ns: int) -> None:
        """Move the joints by the exact solution of a first-order lag."""
        seconds = ns * 1e-9
        faded = 1.0 - math.exp(-seconds / LAG)
        for i, (rate, v) in enumerate(zip(self.rates, self.moving, strict=True)):
            self.q[i] += rate * seconds + (v - rate) * LAG * faded
            self.moving[i] = v + (rate - v) * faded
        self._keep_within()

    def _keep_within(self) -> None:
        """Clip the joints at their limits, where only motion back is permitted."""
        for i, (lower, upper) in enumerate(zip(LOWER, UPPER, strict=True)):
            if not lower < self.q[i] < upper:
                self.q[i] = min(max(self.q[i], lower), upper)
                back = 1.0 if self.q[i] == lower else -1.0
                self.rates[i] = back * max(back * self.rates[i], 0.0)
                self.moving[i] = back * max(back * self.moving[i], 0.0)

    def _answer(self, stamp: int) -> ToyAnswer:
        q, rates = tuple(self.q), tuple(self.rates)
        return ToyAnswer(self.session, self.number, stamp, self.on, self.why, q, rates)


def serve(wire: socket.socket, log: str | None) -> None:
    """Serve the toy arm until Ctrl-C; write a line to the log for each change of its state."""
    toy, before = ToyArm(time.monotonic_ns()), None
    with open(log or "/dev/null", "w", buffering=1) as lines:
        while True:
            select.select([wire], [], [], 0.001)
            for datagram, sender in received(wire):
                answer = toy.hear(datagram, time.monotonic_ns())
                if answer is not None:
                    wire.sendto(answer, sender)
            toy.advance(time.monotonic_ns())
            state = toy.session, toy.on, toy.why, toy.heard, *toy.q
            if state != before:
                print(toy.time, *state, file=lines)
                before = state


def received(wire: socket.socket) -> list[tuple[bytes, object]]:
    """Return waiting datagrams, at most 32, because a flood must not delay the watchdog."""
    found = []
    with contextlib.suppress(OSError):
        while len(found) < 32:
            found.append(wire.recvfrom(512))
    return found


def main() -> None:
    options = argparse.ArgumentParser(description="Toy arm with a UDP interface.")
    options.add_argument("--port", type=int, default=5600, help="UDP port; 0 for a free one")
    options.add_argument("--log", help="file for a log of the arm's state")
    arguments = options.parse_args()
    wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.bind(("127.0.0.1", arguments.port))
    wire.setblocking(False)
    print(f"toy arm at 127.0.0.1:{wire.getsockname()[1]}, Ctrl-C ends it", flush=True)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a script may ignore SIGINT
    with contextlib.suppress(KeyboardInterrupt):
        serve(wire, arguments.log)


if __name__ == "__main__":
    main()
