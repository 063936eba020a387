"""An arm and a camera of one's own, thirty lines each, where no simulator can be imported.

Whoever imports this file hides `rcmservo.sim` and MuJoCo from the process: import it in processes
of their own only.
"""

import sys
import time
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import rcmservo as rs
from rcmservo.live.servo_process import Session
from rcmservo.loop.operator import Operator, OperatorRequest
from rcmservo.recording.writer import Recorder
from rcmservo.tracking import ColourMarkers


class Hidden:
    """Refuses to find the simulator."""

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[:2] == ["rcmservo", "sim"] or name.split(".")[0] == "mujoco":
            raise ImportError(f"{name} is hidden in this process")


sys.meta_path.insert(0, Hidden())
assert not [name for name in sys.modules if name.startswith(("rcmservo.sim", "mujoco"))]

PATIENCE = 1_000_000_000
"""ns without a command after which this arm stops: a busy computer that runs tests may stall."""

START, GOAL = np.array([0.6, 0.2, 120.0]), np.array([0.7, 0.35, 130.0])


class OwnArm:
    """Joints that follow at once. Where they are is in memory that the camera sees: time and q."""

    def __init__(self, seen):
        self.seen = np.frombuffer(seen)
        self.rates, self.enabled, self.heard = np.zeros(3), False, 0
        self.place(START)

    def place(self, q):
        """A person puts the tool there."""
        self.seen[:] = time.monotonic_ns(), *q

    def enable(self):
        self.rates, self.enabled, self.heard = np.zeros(3), True, time.monotonic_ns()

    def measure(self):
        now = time.monotonic_ns()
        if now > self.heard + PATIENCE:
            self.rates, self.enabled = np.zeros(3), False
        q = self.seen[1:] + self.rates * (now - self.seen[0]) * 1e-9
        self.seen[:] = now, *q
        return rs.Measured(now, q, self.enabled)

    def apply(self, command):
        self.measure()
        self.heard, self.enabled = time.monotonic_ns(), self.enabled and command.enabled
        self.rates = command.rates * self.enabled
        return self.rates.copy()


class OwnCamera:
    """Thirty pictures a second of two discs, one green, one blue, before a grey wall."""

    def __init__(self, seen):
        self.seen, self.frame = np.frombuffer(seen), None
        tool = tool_at(START)
        self.place = tool.mean(axis=0) + 350.0 * np.array([0.3, -0.9, 0.4])
        forward = (tool.mean(axis=0) - self.place) / np.linalg.norm(tool.mean(axis=0) - self.place)
        right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
        self.turned = np.stack([right, np.cross(forward, right), forward])

    def latest(self):
        exposure, *q = self.seen.copy()
        if self.frame is None or exposure - self.frame.exposure > 30_000_000:
            number = 0 if self.frame is None else self.frame.number + 1
            image = self.drawn(np.array(q))
            self.frame = rs.Frame(number, int(exposure), time.monotonic_ns(), image=image)
        return self.frame

    def drawn(self, q):
        image = np.full((240, 320, 3), 90, np.uint8)
        v, u = np.mgrid[0:240, 0:320]
        for p, paint in zip(tool_at(q), ([40, 190, 40], [200, 60, 20]), strict=True):
            x, y, z = self.turned @ (p - self.place)
            away = np.hypot(u - 400.0 * x / z - 160.0, v - 400.0 * y / z - 120.0)
            cover = np.clip(6.0 * 400.0 / z - away + 0.5, 0.0, 1.0)[..., None]
            image = np.uint8(np.round(cover * paint + (1.0 - cover) * image))
        return image


def tool_at(q):
    """Both markers (2, 3) mm: eq. (2), written down once more, and a rigid tool."""
    theta, phi, rho = q
    way = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    return np.outer([rho, rho + 30.0], way)


def own_arm(seen):
    """The factory: it would raise where the simulator can be had."""
    try:
        import rcmservo.sim  # noqa: F401
    except ImportError:
        return OwnArm(seen)
    raise AssertionError("the simulator can be imported in the servo process")


def shown(plant):
    """A person shows the goal and brings the tool back."""
    plant.arm.place(GOAL)
    target = rs.teach(plant, frames=10)
    plant.arm.place(START)
    return target


class Person:
    """Pauses and resumes, slows down, retargets and teaches: one after the other, once it servoes;
    resumes whatever else may stop a loop on a busy computer, and is ``done`` when it servoes
    again.
    """

    def __init__(self, slow: rs.Servo, done: Any) -> None:
        self.wants: list[OperatorRequest] = [rs.Request.PAUSE, slow, rs.Teach(frames=5)]
        self.servoed, self.done = 0, done

    def __call__(self, tick: rs.Tick) -> OperatorRequest:
        state = tick.state
        self.servoed += state.phase is rs.Phase.SERVO
        taught = len(self.wants) > 0 or state.target.shown > tick.seen.now - tick.time
        if state.phase is rs.Phase.PAUSED and not state.command.rates.any() and taught:
            return rs.Request.RESUME
        if self.servoed >= 15 and self.wants:
            self.servoed = 0
            return self.wants.pop(0)
        self.done.value = self.servoed >= 15
        return rs.Request.NONE


def person(servo: rs.Servo, done: Any) -> Operator:
    return Person(servo, done)


def own_servo(gain: float = 2.0) -> rs.Servo:
    patient = rs.Thresholds(overrun=1.0, latency=1.0, stale_slow=50.0, stale_hold=50.0, silence=1.0)
    law = rs.SaturatedController(gain=gain)
    return rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0), controller=law, thresholds=patient)


def session(record: Path, seconds: float, done: Any) -> Session:
    """A live run of the two devices, with a person beside it."""
    seen = get_context("spawn").RawArray("d", 4)
    return Session(
        own_servo(),
        seconds,
        arm=partial(own_arm, seen),
        camera=partial(OwnCamera, seen),
        tracker=ColourMarkers,
        target=shown,
        recorder=partial(Recorder, record, {}),
        operator=partial(person, own_servo(gain=1.0), done),
    )
