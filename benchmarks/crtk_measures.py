"""Test bench of the CRTK driver, for benchmarks and tests.

The device and its log run in this process, its client in another one, which can be killed.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from rcmservo.geometry.kinematics import SphericalRcm
from rcmservo.hardware.crtk import messages as m
from rcmservo.hardware.crtk.arm import CrtkArm
from rcmservo.hardware.crtk.device import STEP_NS, CrtkDevice
from rcmservo.hardware.crtk.messages import MessageHandler, Transport
from rcmservo.hardware.crtk.settings import CrtkSettings, RosConnection
from rcmservo.hardware.crtk.transport import open_transport
from rcmservo.interfaces import Command, Floats
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.loop.clock import WallClock, ticks
from rcmservo.sim import Rig
from rcmservo.sim.arm import Drive
from rcmservo.sim.motor_interface import SimulatedJoints

NAME = "PSM1"
PATIENCE = 50_000_000
SWING = np.array([0.3, 0.3, 20.0])
"""Amplitude (rad/s, rad/s, mm/s) of the oscillation that a client commands."""

COUNT = np.array(Drive().encoder)
"""Resolution (rad, rad, mm) of the joint encoders."""

MOVING = 50_000_000
"""Time (ns) before the kill of a client within which the arm must have moved."""

ROWS = 5000
"""Number of steps of the arm in the log."""


class Counted:
    """Transport that counts received messages by topic."""

    def __init__(self, inner: Transport) -> None:
        self.inner, self.heard = inner, dict[str, int]()

    def publish(self, topic: m.Topic[Any], message: Any) -> bool:
        return self.inner.publish(topic, message)

    def offer(self, topic: m.Topic[Any]) -> None:
        self.inner.offer(topic)

    def count_listeners(self, topic: m.Topic[Any]) -> int:
        return self.inner.count_listeners(topic)

    def subscribe(self, topic: m.Topic[Any], handler: MessageHandler[Any]) -> None:
        def counted(said: Any, writer: str) -> None:
            self.heard[topic.name] = self.heard.get(topic.name, 0) + 1
            handler(said, writer)

        self.inner.subscribe(topic, counted)

    def close(self) -> None:
        self.inner.close()


class RunningDevice:
    """Emulated device in wall time, in a thread."""

    def __init__(self, ros: int, domain: int, seed: int = 3) -> None:
        self.transport = Counted(open_transport(RosConnection(ros=ros, domain=domain)))
        rig = Rig(seed, pictures=False)
        arm = rig.truth.arm
        joints = SimulatedJoints(arm)
        limits = rig.settings.mechanism.limits
        now = time.monotonic_ns()
        arm.time = now // STEP_NS * STEP_NS
        arm.place(rig.scene.start)
        self._rows = deque[tuple[int, Floats]](maxlen=ROWS)
        arm.before_step = lambda: self._rows.append((arm.time - STEP_NS, arm.q_true))
        self.device = CrtkDevice(joints, limits, self.transport, NAME, now, time.time_ns)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def _live(self) -> None:
        with apply_realtime_settings():
            while not self._over.is_set():
                now = time.monotonic_ns()
                self.device.update(now)
                time.sleep((STEP_NS - now % STEP_NS) * 1e-9)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.transport.close()

    def went(self, since: int) -> bool:
        """Return whether a joint moved by more than a count since the device time `since` (ns)."""
        rows = [q for time, q in list(self._rows) if time >= since]
        return bool((np.abs(np.array(rows) - rows[0]) > COUNT).any()) if rows else False

    def moved_last(self) -> int:
        """Return the device time (ns) of the last motion by more than a count; 0 if none."""
        times, q = (np.array(column) for column in zip(*list(self._rows), strict=True))
        is_distant = (np.abs(q - q[-1]) > COUNT).any(axis=1)
        return int(times[is_distant][-1]) if is_distant.any() else 0


def client_arm(ros: int, domain: int) -> CrtkArm:
    """Return a connected client of the device."""
    settings = CrtkSettings(NAME, ros=ros, domain=domain)
    return CrtkArm(
        settings, SphericalRcm().limits, open_transport(RosConnection(ros=ros, domain=domain))
    )


def swing(seconds: float) -> Floats:
    """Return the oscillating joint rates (3,) at a time (s) after the start."""
    return SWING * np.cos(2.0 * np.pi * seconds / 4.0)


def drive(ros: int, domain: int, seconds: float) -> None:
    """Run a client for some seconds: print "moving" during the motion, then its account."""
    print(json.dumps(driven(ros, domain, seconds)), flush=True)


def driven(ros: int, domain: int, seconds: float) -> dict[str, Any]:
    """Run a client for some seconds in this process; return the account of its commands."""
    arm, clock = client_arm(ros, domain), WallClock()
    arm.enable()
    number = 0
    with apply_realtime_settings():
        for passed in ticks(clock, 100.0, seconds):
            now = clock.now()
            arm.apply(Command(number, now, now + PATIENCE, swing(passed * 1e-9), True))
            number += 1
            if number == 50:
                print("moving", flush=True)
    time.sleep(0.02)
    account, state = arm.command_counts(), arm.measure()
    arm.close()
    return account.__dict__ | {"commands": number, "on": state.enabled}


@contextmanager
def driving(ros: int, domain: int, seconds: float) -> Iterator[subprocess.Popen[str]]:
    """Run a client in another process in the context; it moves the arm."""
    code = f"from crtk_measures import drive; drive({ros}, {domain}, {seconds})"
    paths = [os.path.dirname(__file__), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as client:
        try:
            assert client.stdout is not None
            if client.stdout.readline() != "moving\n":
                raise RuntimeError("the client did not move the arm")
            yield client
        finally:
            client.kill()


def streamed(ros: int, domain: int, device: RunningDevice, seconds: float) -> dict[str, Any]:
    """Return the account of all commands of some seconds at 100 Hz, with the received ones."""
    before = device.transport.heard.get(f"{NAME}/servo_jp", 0)
    with driving(ros, domain, seconds) as client:
        assert client.stdout is not None
        account = json.loads(client.stdout.readline())
    heard = device.transport.heard[f"{NAME}/servo_jp"] - before
    return account | {"heard": heard}


def killed(ros: int, domain: int, device: RunningDevice, wait: float) -> float:
    """Kill a client during a motion; return the time (ms) until the arm was at rest.

    The arm must have moved within `MOVING` before the kill, otherwise the trial proves nothing.
    """
    with driving(ros, domain, 30.0) as client:
        time.sleep(wait)
        client.send_signal(signal.SIGKILL)
        at = time.monotonic_ns()
        if not device.went(at - MOVING):
            raise RuntimeError("the arm did not move when its client was killed")
        client.wait()
        end = at + 2_000_000_000
        while time.monotonic_ns() < end and time.monotonic_ns() - device.moved_last() < 300_000_000:
            time.sleep(0.02)
    return (device.moved_last() - at) * 1e-6
