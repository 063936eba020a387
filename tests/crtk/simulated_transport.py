"""Simulated transport and clock in one process: it can lose, repeat, forge and delay messages.

Other tests use the real transports.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from rcmservo.geometry.kinematics import JointLimits
from rcmservo.hardware.crtk.arm import CrtkArm
from rcmservo.hardware.crtk.device import REPORT_PERIOD_NS, CrtkDevice
from rcmservo.hardware.crtk.messages import Topic
from rcmservo.hardware.crtk.settings import CrtkSettings
from rcmservo.interfaces import Command, Floats

LIMITS = JointLimits((-1.0, -0.7, 20.0), (1.0, 0.7, 200.0))
START = np.array([0.1, -0.2, 100.0])
RATES = np.array([0.2, -0.2, 20.0])
MS = 1_000_000
TICK, PATIENCE = 10_000_000, 50_000_000
EPOCH = 1_700_000_000_000_000_000
"""ns of calendar time at the clock's zero."""


class SimulatedNetwork:
    """Network that connects all endpoints: subscribers by topic, and a log of all messages."""

    def __init__(self) -> None:
        self.listeners: dict[str, list[tuple[Endpoint, Callable[[Any, str], None]]]] = {}
        self.sent: list[tuple[str, Any]] = []
        self.lose: Callable[[str, Any], bool] = lambda topic, message: False
        self.latched: dict[str, tuple[Endpoint, Any]] = {}

    def endpoint(self, name: str) -> "Endpoint":
        return Endpoint(self, name)

    def texts(self, topic: str) -> list[str]:
        """Return the strings sent on a topic."""
        return [message.string for name, message in self.sent if name == topic]


class Endpoint:
    """Endpoint of the network, as a transport."""

    def __init__(self, network: SimulatedNetwork, name: str) -> None:
        self.network, self.name, self.open = network, name, True

    def publish(self, topic: Topic[Any], message: Any) -> bool:
        assert self.open
        if self.network.lose(topic.name, message):
            return False
        self.network.sent.append((topic.name, message))
        if topic.latched:
            self.network.latched[topic.name] = self, message
        for endpoint, handler in self.network.listeners.get(topic.name, []):
            if endpoint is not self and endpoint.open:
                handler(message, self.name)
        return True

    def offer(self, topic: Topic[Any]) -> None:
        pass

    def count_listeners(self, topic: Topic[Any]) -> int:
        listening = self.network.listeners.get(topic.name, [])
        return sum(one is not self and one.open for one, _ in listening)

    def subscribe(self, topic: Topic[Any], handler: Callable[[Any, str], None]) -> None:
        self.network.listeners.setdefault(topic.name, []).append((self, handler))
        if topic.latched and topic.name in self.network.latched:
            sender, message = self.network.latched[topic.name]
            handler(message, sender.name)

    def close(self) -> None:
        self.open = False


class IdealJoints:
    """Joints that follow their rates without a lag."""

    def __init__(self) -> None:
        self.q, self._time = START.copy(), 0

    def step(self, rates: Floats, on: bool, time: int) -> Floats:
        self.q = self.q + (rates * (time - self._time) * 1e-9 if on and self._time else 0.0)
        self._time = time
        return self.q


class CrtkLab:
    """Emulated arm and its clients on one simulated clock."""

    def __init__(self, **settings: Any) -> None:
        self.now, self.number = TICK, -1
        self.clients: list[CrtkArm] = []
        self.network, self.joints = SimulatedNetwork(), IdealJoints()
        self.device = CrtkDevice(
            self.joints, LIMITS, self.network.endpoint("device"), "PSM1", self.now, self.real
        )
        self.settings = CrtkSettings("PSM1", **({"reply_timeout": 0.1} | settings))

    def real(self) -> int:
        return EPOCH + self.now

    def client(self, name: str = "client") -> CrtkArm:
        """Return a connected client, whose own watching thread does nothing."""
        endpoint = self.network.endpoint(name)
        subscribe = endpoint.subscribe

        def subscribe_and_advance(topic: Topic[Any], handler: Callable[[Any, str], None]) -> None:
            subscribe(topic, handler)
            self.advance(REPORT_PERIOD_NS)

        endpoint.subscribe = subscribe_and_advance
        self.clients.append(SimulatedClient(self, endpoint))
        return self.clients[-1]

    def advance(self, time: int) -> None:
        """Advance the clock by some ns, in steps of 1 ms, with the device and all clients."""
        for _ in range(time // 1_000_000):
            self.now += 1_000_000
            self.device.update(self.now)
            for client in self.clients:
                client.check_deadlines()

    def tick(self, arm: CrtkArm, rates: Floats, delay: int = 0) -> Floats:
        """Send a command and advance the clock by 10 ms and a delay."""
        self.number += 1
        applied = arm.apply(Command(self.number, self.now, self.now + PATIENCE, rates, True))
        self.advance(TICK + delay)
        return applied


class SimulatedClient(CrtkArm):
    """Client whose device executes state commands at once."""

    def __init__(self, lab: CrtkLab, endpoint: Endpoint) -> None:
        self._lab = lab
        super().__init__(lab.settings, LIMITS, endpoint, lambda: lab.now, lab.real)

    def _watch(self) -> None:
        """Do nothing: the lab checks the deadlines on its own clock."""

    def _send_state_command(self, command: str) -> None:
        super()._send_state_command(command)
        self._lab.device.update(self._lab.now)


def moving_arm(ticks: int = 50, **settings: Any) -> tuple[CrtkLab, CrtkArm]:
    """Return a lab and its arm, enabled and moved for some ticks."""
    lab = CrtkLab(**settings)
    arm = lab.client()
    arm.enable()
    for _ in range(ticks):
        lab.tick(arm, RATES)
    return lab, arm


def setpoints(lab: CrtkLab) -> list[Any]:
    """Return the position commands sent to the arm."""
    return [message for topic, message in lab.network.sent if topic == "PSM1/servo_jp"]
