"""Two ends of a transport in one process, at once and on an injected clock, for what a real one
cannot be made to do: lose, repeat, forge and delay at will. The real ones are tried beside it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from rcmservo.hardware.crtk.arm import CrtkArm
from rcmservo.hardware.crtk.device import TOLD, CrtkDevice
from rcmservo.hardware.crtk.messages import Topic
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.interfaces import Command, Floats
from rcmservo.method.kinematics import JointLimits

LIMITS = JointLimits((-1.0, -0.7, 20.0), (1.0, 0.7, 200.0))
START = np.array([0.1, -0.2, 100.0])
RATES = np.array([0.2, -0.2, 20.0])
MS = 1_000_000
TICK, PATIENCE = 10_000_000, 50_000_000
EPOCH = 1_700_000_000_000_000_000
"""ns of calendar time at the clock's zero."""


class Wire:
    """What the ends share: who listens to what."""

    def __init__(self) -> None:
        self.listeners: dict[str, list[tuple[End, Callable[[Any, str], None]]]] = {}
        self.said: list[tuple[str, Any]] = []
        self.lose: Callable[[str, Any], bool] = lambda topic, said: False
        self.kept: dict[str, tuple[End, Any]] = {}

    def end(self, name: str) -> "End":
        return End(self, name)

    def words(self, topic: str) -> list[str]:
        """The strings that were said on a topic."""
        return [said.string for name, said in self.said if name == topic]


class End:
    """One end."""

    def __init__(self, wire: Wire, name: str) -> None:
        self.wire, self.name, self.open = wire, name, True

    def publish(self, topic: Topic[Any], message: Any) -> bool:
        assert self.open
        if self.wire.lose(topic.name, message):
            return False
        self.wire.said.append((topic.name, message))
        if topic.latched:
            self.wire.kept[topic.name] = self, message
        for end, heard in self.wire.listeners.get(topic.name, []):
            if end is not self and end.open:
                heard(message, self.name)
        return True

    def offer(self, topic: Topic[Any]) -> None:
        pass

    def listeners(self, topic: Topic[Any]) -> int:
        listening = self.wire.listeners.get(topic.name, [])
        return sum(end is not self and end.open for end, _ in listening)

    def subscribe(self, topic: Topic[Any], heard: Callable[[Any, str], None]) -> None:
        self.wire.listeners.setdefault(topic.name, []).append((self, heard))
        if topic.latched and topic.name in self.wire.kept:
            sender, message = self.wire.kept[topic.name]
            heard(message, sender.name)

    def close(self) -> None:
        self.open = False


class IdealJoints:
    """Joints that have their rates at once."""

    def __init__(self) -> None:
        self.q, self._time = START.copy(), 0

    def step(self, rates: Floats, on: bool, time: int) -> Floats:
        self.q = self.q + (rates * (time - self._time) * 1e-9 if on and self._time else 0.0)
        self._time = time
        return self.q


class CrtkLab:
    """A device and its client on one clock, which nobody else moves on."""

    def __init__(self, **settings: Any) -> None:
        self.now, self.number = TICK, -1
        self.clients: list[CrtkArm] = []
        self.wire, self.joints = Wire(), IdealJoints()
        self.device = CrtkDevice(
            self.joints, LIMITS, self.wire.end("device"), "PSM1", self.now, self.real
        )
        self.settings = CrtkSettings("PSM1", **({"answer_within": 0.1} | settings))

    def real(self) -> int:
        return EPOCH + self.now

    def client(self, name: str = "client") -> CrtkArm:
        """A client that has heard of the device, with its own watching thread asleep."""
        end = self.wire.end(name)
        subscribe = end.subscribe

        def and_pass(topic: Topic[Any], heard: Callable[[Any, str], None]) -> None:
            subscribe(topic, heard)
            self.let_pass(TOLD)

        end.subscribe = and_pass
        self.clients.append(Obeyed(self, end))
        return self.clients[-1]

    def let_pass(self, time: int) -> None:
        """Let so many ns pass, ms by ms, the device heeding all."""
        for _ in range(time // 1_000_000):
            self.now += 1_000_000
            self.device.turn(self.now)
            for client in self.clients:
                client.look_after()

    def tick(self, arm: CrtkArm, rates: Floats, late: int = 0) -> Floats:
        """A command of a loop that looks a little late, and 10 ms behind it."""
        self.number += 1
        took = arm.apply(Command(self.number, self.now, self.now + PATIENCE, rates, True))
        self.let_pass(TICK + late)
        return took


class Obeyed(CrtkArm):
    """A client whose device is there at once, as a device in another process would be."""

    def __init__(self, lab: CrtkLab, end: End) -> None:
        self._lab = lab
        super().__init__(lab.settings, LIMITS, end, lambda: lab.now, lab.real)

    def _watch(self) -> None:
        """Who watches is the lab, on its own clock."""

    def _say(self, word: str) -> None:
        super()._say(word)
        self._lab.device.turn(self._lab.now)


def driven(ticks: int = 50, **settings: Any) -> tuple[CrtkLab, CrtkArm]:
    """A lab whose arm was enabled and went so far."""
    lab = CrtkLab(**settings)
    arm = lab.client()
    arm.enable()
    for _ in range(ticks):
        lab.tick(arm, RATES)
    return lab, arm


def sent(lab: CrtkLab) -> list[Any]:
    return [said for topic, said in lab.wire.said if topic == "PSM1/servo_jp"]
