"""A toy arm in a process of its own, on the rules that hardware should have. Nothing real moves.

    python examples/udp_arm/toy_arm.py --port 5600

It is kinematics alone: three joints that follow the rates they are given with a small lag. All of
its rules are in `ToyArm`, which is told the time and has no socket: docs/own_devices.md says what
each of them prevents.
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
"""rad, rad, mm between which the joints stay."""

FASTEST = 1.0, 1.0, 100.0
"""rad/s, rad/s, mm/s at most."""

LAG = 0.015
"""s, the time constant with which the joints follow."""

PATIENCE = 50_000_000
"""ns without a command after which it stops by itself."""

TOLD, RAN_OUT = 1, 2
"""Why it is off; the words are in toy_wire."""

START = 0.6, 0.2, 120.0


class ToyArm:
    """The device. Its time is that of its own clock, ns, which nobody can set."""

    def __init__(self, now: int) -> None:
        self.q, self.rates, self.moving = list(START), [0.0] * 3, [0.0] * 3
        self.on, self.why = False, 0
        self.session, self.number, self.had = 0, 0, {0}
        self.time = self.heard = now

    def hear(self, datagram: bytes, now: int) -> bytes | None:
        """Do what a datagram says, if it may, and answer; what is damaged is dropped."""
        order = order_in(datagram)
        if order is None:
            return None
        self.advance(now)
        if order.kind == ENABLE and not self.on and order.session not in self.had:
            self.had.add(order.session)
            self.on, self.why, self.session, self.number = True, 0, order.session, 0
            self.heard = now
        elif order.kind == OFF:
            self._off(TOLD)
        elif order.kind == JOG and self._may_move(order):
            self.number, self.heard = order.number, now
            self.rates = [
                min(max(rate, -most), most) for rate, most in zip(order.rates, FASTEST, strict=True)
            ]
            self._keep_within()
        return sent(self._answer(order.stamp))

    def _may_move(self, order: ToyOrder) -> bool:
        """Only who has it moves it, and only by an order that is newer than all before."""
        return self.on and order.session == self.session and order.number > self.number

    def advance(self, now: int) -> None:
        """Let time pass. The watchdog's end is the end of motion, also if we look at it later."""
        end = self.heard + PATIENCE
        if self.on and now > end:
            self._move(end - self.time)
            self._off(RAN_OUT)
        elif self.on:
            self._move(now - self.time)
        self.time = now

    def _off(self, why: int) -> None:
        """The drive is off and the brakes are on: it stands still."""
        if self.on:
            self.on, self.why = False, why
        self.rates, self.moving = [0.0] * 3, [0.0] * 3

    def _move(self, ns: int) -> None:
        """The joints follow their rates: exactly what a first order lag does in this time."""
        seconds = ns * 1e-9
        faded = 1.0 - math.exp(-seconds / LAG)
        for i, (rate, v) in enumerate(zip(self.rates, self.moving, strict=True)):
            self.q[i] += rate * seconds + (v - rate) * LAG * faded
            self.moving[i] = v + (rate - v) * faded
        self._keep_within()

    def _keep_within(self) -> None:
        """At a limit only the way back is open."""
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
    """Be the toy until Ctrl-C. The log has a line for every turn in which something was new."""
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
    """What waits in the socket, not more than a few: a flood must not hold the watchdog."""
    found = []
    with contextlib.suppress(OSError):
        while len(found) < 32:
            found.append(wire.recvfrom(512))
    return found


def main() -> None:
    options = argparse.ArgumentParser(description="A toy arm that hangs on UDP.")
    options.add_argument("--port", type=int, default=5600, help="0 takes one that is free")
    options.add_argument("--log", help="file for its own account of what it did")
    asked = options.parse_args()
    wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.bind(("127.0.0.1", asked.port))
    wire.setblocking(False)
    print(f"toy arm at 127.0.0.1:{wire.getsockname()[1]}, Ctrl-C ends it", flush=True)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a script may have it ignored
    with contextlib.suppress(KeyboardInterrupt):
        serve(wire, asked.log)


if __name__ == "__main__":
    main()
