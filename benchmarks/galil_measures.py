"""Test bench of the Galil driver and the emulated controller, for benchmarks and tests."""

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
from rcmservo.geometry.kinematics import JointLimits, SphericalRcm
from rcmservo.hardware.galil.connection import GalilConnection
from rcmservo.hardware.galil.driver import GalilArm
from rcmservo.hardware.galil.emulator.controller import SAMPLE_TIME_S, GalilController
from rcmservo.hardware.galil.session import GalilSession
from rcmservo.hardware.galil.settings import GalilSettings

SETTINGS = GalilSettings(address="nowhere", counts=(50000.0, -50000.0, 500.0))
LIMITS = JointLimits((-1.0, -1.0, 0.0), (1.0, 1.0, 200.0))
HOME = np.array([0.1, -0.2, 100.0])
RATES = np.array([0.2, 0.3, -20.0])


class IdealMotors:
    """Motors that follow their commanded speed without a lag."""

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


class EmulatedStream:
    """Stream of a host to an emulated controller, whose time advances while the host waits."""

    def __init__(self, controller: GalilController) -> None:
        self.controller = controller
        self.handle = controller.connect()
        self.deaf = False

    def send(self, data: bytes) -> None:
        if self.handle not in self.controller.connections:
            raise BrokenPipeError("gone")
        if not self.deaf:
            assert self.handle is not None
            self.controller.receive(self.handle, data)
        self.controller.sample()  # the transmission takes one sample

    def receive(self, seconds: float) -> bytes:
        end = self.controller.state.samples * SAMPLE_TIME_S + seconds
        while self.handle in self.controller.connections:
            output = self.controller.take_output(self.handle)
            if output or self.controller.state.samples * SAMPLE_TIME_S >= end:
                return output
            self.controller.sample()
        raise ConnectionResetError("gone")

    def close(self) -> None:
        assert self.handle is not None
        self.controller.disconnect(self.handle)


class GarblingStream(EmulatedStream):
    """Stream that randomly cuts, changes, doubles or drops replies."""

    def __init__(
        self, controller: GalilController, chance: random.Random, probability: float
    ) -> None:
        super().__init__(controller)
        self.chance, self.probability, self.sent = chance, probability, b""

    def send(self, data: bytes) -> None:
        self.sent += data
        super().send(data)

    def receive(self, seconds: float) -> bytes:
        output = super().receive(seconds)
        if not output or self.chance.random() >= self.probability:
            return output
        at = self.chance.randrange(len(output))
        return self.chance.choice(
            [
                output[:at],
                output[:at] + self.chance.randbytes(1) + output[at + 1 :],
                output + output,
                output[at:],
                self.chance.randbytes(at),
                b"",
            ]
        )


class ScriptedStream:
    """Stream that receives some packets in turn. Its time advances during waits."""

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


SESSION_STEPS: dict[str, Callable[[GalilSession], Any]] = {
    "set_up": lambda session: session.set_up(),
    "set_position": lambda session: session.set_position(HOME),
    "start": lambda session: session.start(),
    "exchange": lambda session: session.exchange(RATES),
    "read": lambda session: session.read(),
    "switch_off": lambda session: session.switch_off(),
}


def run_with_packets(packets: Iterable[bytes], step: str) -> ScriptedStream:
    """Run one step of a session against some packets; an error must be one short sentence."""
    streams = ScriptedStream(*packets), ScriptedStream(b":")
    connections = [GalilConnection(stream, 0.25, streams[0].now) for stream in streams]
    session = GalilSession(*connections, SETTINGS, LIMITS)
    try:
        SESSION_STEPS[step](session)
    except RcmServoError as error:
        assert "\n" not in str(error) and len(str(error)) < 500
    return streams[0]


def run_with_garbling(chance: random.Random) -> tuple[float, bool, bool]:
    """Run a whole session on a stream that garbles replies.

    Returns the duration of the longest step in s, whether an axis moved, and whether all axes are
    at rest with the motors off 0.2 s after the end. The motors are on after a reset of the
    controller, so they count only if the first step has succeeded.
    """
    controller = GalilController(IdealMotors())
    probability = chance.choice([0.003, 0.01, 0.03, 0.1])
    streams = [GarblingStream(controller, chance, probability) for _ in range(2)]

    def now() -> float:
        return controller.state.samples * SAMPLE_TIME_S

    connections = [GalilConnection(stream, 0.25, now) for stream in streams]
    session = GalilSession(*connections, SETTINGS, LIMITS)
    longest, began, ready = 0.0, False, False
    try:
        for step in ("set_up", "set_position", "start", *["exchange"] * 50, "switch_off"):
            begin = now()
            SESSION_STEPS[step](session)
            assert ready or b"SH" not in streams[0].sent
            longest, ready = max(longest, now() - begin), True
            began = began or any(axis.moving for axis in controller.state.axes)
    except RcmServoError as error:
        longest = max(longest, now() - begin)
        began = began or any(axis.moving for axis in controller.state.axes)
        assert "\n" not in str(error) and len(str(error)) < 500
    for _ in range(205):
        controller.sample()
    still = not any(axis.moving or axis.speed for axis in controller.state.axes)
    off = all(axis.motor_off for axis in controller.state.axes[:3])
    return longest, began, still and (off or not ready)


class Emulated:
    """Process that runs `rcmservo emulate galil` on a free port."""

    def __init__(self, *options: str) -> None:
        command = [sys.executable, "-m", "rcmservo", "emulate", "galil", "--port", "0", *options]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        match = re.search(r"127\.0\.0\.1:(\d+)(?: and (\S+),)?", self.process.stdout.readline())
        assert match is not None
        self.port, self.serial = int(match[1]), match[2]

    def arm(self) -> GalilArm:
        """Connect the driver, over the serial port if there is one."""
        settings = GalilSettings(self.serial or "127.0.0.1", (50000.0, 50000.0, 500.0), self.port)
        return GalilArm(settings, SphericalRcm().limits)

    def close(self) -> None:
        os.kill(self.process.pid, signal.SIGCONT)
        self.process.terminate()
        self.process.communicate(timeout=30.0)
