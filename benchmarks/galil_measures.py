"""What the Galil driver and the emulated controller are measured with; tests ask a part."""

import os
import random
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.emulator.controller import SAMPLE, Controller
from rcmservo.hardware.galil.session import GalilSession
from rcmservo.hardware.galil.settings import GalilSettings
from rcmservo.hardware.galil.wire import Conversation
from rcmservo.method.kinematics import JointLimits, SphericalRcm

SETTINGS = GalilSettings(address="nowhere", counts=(50000.0, -50000.0, 500.0))
LIMITS = JointLimits((-1.0, -1.0, 0.0), (1.0, 1.0, 200.0))
HOME = np.array([0.1, -0.2, 100.0])
RATES = np.array([0.2, 0.3, -20.0])


class IdealMotors:
    """Motors that do at once what they are asked for."""

    lag = 0.0

    def __init__(self, axes: int = 4) -> None:
        self.counts = [0.0] * axes
        self.tripped = [(False, False)] * axes

    def step(self, speeds: Sequence[float], on: Sequence[bool], seconds: float) -> Sequence[float]:
        made = zip(self.counts, speeds, on, strict=True)
        self.counts = [count + speed * seconds * ready for count, speed, ready in made]
        return self.counts

    def switches(self) -> Sequence[tuple[bool, bool]]:
        return self.tripped


class EmulatedWire:
    """A host's stream to an emulated controller, whose time passes while the host waits."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.handle = controller.connect()
        self.deaf = False

    def send(self, data: bytes) -> None:
        if self.handle not in self.controller.lines:
            raise BrokenPipeError("gone")
        if not self.deaf:
            assert self.handle is not None
            self.controller.hear(self.handle, data)
        self.controller.sample()  # what the way there takes

    def receive(self, seconds: float) -> bytes:
        end = self.controller.state.samples * SAMPLE + seconds
        while self.handle in self.controller.lines:
            told = self.controller.answers(self.handle)
            if told or self.controller.state.samples * SAMPLE >= end:
                return told
            self.controller.sample()
        raise ConnectionResetError("gone")

    def close(self) -> None:
        assert self.handle is not None
        self.controller.disconnect(self.handle)


class GarbledWire(EmulatedWire):
    """One on which an answer is cut, changed, doubled or lost by chance."""

    def __init__(self, controller: Controller, chance: random.Random, share: float) -> None:
        super().__init__(controller)
        self.chance, self.share, self.sent = chance, share, b""

    def send(self, data: bytes) -> None:
        self.sent += data
        super().send(data)

    def receive(self, seconds: float) -> bytes:
        told = super().receive(seconds)
        if not told or self.chance.random() >= self.share:
            return told
        at = self.chance.randrange(len(told))
        return self.chance.choice(
            [
                told[:at],
                told[:at] + self.chance.randbytes(1) + told[at + 1 :],
                told + told,
                told[at:],
                self.chance.randbytes(at),
                b"",
            ]
        )


class Typed:
    """A stream that answers each line with the next of some packets, and whose time passes while
    one waits."""

    def __init__(self, *packets: bytes) -> None:
        self.packets, self.sent, self.time = list(packets), b"", 0.0

    def now(self) -> float:
        return self.time

    def send(self, data: bytes) -> None:
        self.sent += data

    def receive(self, seconds: float) -> bytes:
        self.time += seconds if not self.packets else 1e-4
        if seconds == 0.0:
            return b""
        return self.packets.pop(0) if self.packets else b""

    def close(self) -> None:
        pass


ASKED: dict[str, Callable[[GalilSession], Any]] = {
    "set_up": lambda session: session.set_up(),
    "define": lambda session: session.define(HOME),
    "start": lambda session: session.start(),
    "exchange": lambda session: session.exchange(RATES),
    "look": lambda session: session.look(),
    "switch_off": lambda session: session.switch_off(),
}


def fuzzed(packets: Iterable[bytes], asked: str) -> Typed:
    """What is asked for, answered with these packets: one sentence at most, and soon."""
    streams = Typed(*packets), Typed(b":")
    talks = [Conversation(stream, 0.25, streams[0].now) for stream in streams]
    session = GalilSession(*talks, SETTINGS, LIMITS)
    try:
        ASKED[asked](session)
    except RcmServoError as error:
        assert "\n" not in str(error) and len(str(error)) < 500
    return streams[0]


def garbled(chance: random.Random) -> tuple[float, bool, bool]:
    """A whole use of a controller on a wire that garbles answers: s that its longest step took,
    whether axes were begun, and whether they stand 0.2 s after the end, with the motors off, if
    they have ever been: after a reset of the controller they are on."""
    controller, share = Controller(IdealMotors()), chance.choice([0.003, 0.01, 0.03, 0.1])
    wires = [GarbledWire(controller, chance, share) for _ in range(2)]

    def now() -> float:
        return controller.state.samples * SAMPLE

    talks = [Conversation(wire, 0.25, now) for wire in wires]
    session = GalilSession(*talks, SETTINGS, LIMITS)
    longest, began, ready = 0.0, False, False
    try:
        for asked in ("set_up", "define", "start", *["exchange"] * 50, "switch_off"):
            begin = now()
            ASKED[asked](session)
            assert ready or b"SH" not in wires[0].sent
            longest, ready = max(longest, now() - begin), True
            began = began or any(axis.moving for axis in controller.state.axes)
    except RcmServoError as error:
        longest = max(longest, now() - begin)
        began = began or any(axis.moving for axis in controller.state.axes)
        assert "\n" not in str(error) and len(str(error)) < 500
    for _ in range(205):
        controller.sample()
    still = not any(axis.moving or axis.speed for axis in controller.state.axes)
    off = all(axis.off for axis in controller.state.axes[:3])
    return longest, began, still and (off or not ready)


class Emulated:
    """`rcmservo emulate galil`, on a port that is free; `close` it at the end."""

    def __init__(self, *options: str) -> None:
        command = [sys.executable, "-m", "rcmservo", "emulate", "galil", "--port", "0", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        said = re.search(r"127\.0\.0\.1:(\d+)(?: and (\S+),)?", self.process.stdout.readline())
        assert said is not None
        self.port, self.serial = int(said[1]), said[2]

    def arm(self) -> GalilArm:
        """The driver of the arm behind it, by its serial port where it has one."""
        settings = GalilSettings(self.serial or "127.0.0.1", (50000.0, 50000.0, 500.0), self.port)
        return GalilArm(settings, SphericalRcm().limits)

    def close(self) -> None:
        os.kill(self.process.pid, signal.SIGCONT)
        self.process.terminate()
        self.process.communicate(timeout=30.0)
