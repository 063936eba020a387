"""User-defined arm and camera of thirty lines each, where no simulator can be imported.

Importing this file hides `rcmservo.sim` and MuJoCo from the process, so import it in separate
processes only.
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
from rcmservo.rig.lazy_rig import LazyRig
from rcmservo.tracking import ColourMarkers


class Hidden:
    """Import hook that hides the simulator."""

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[:2] == ["rcmservo", "sim"] or name.split(".")[0] == "mujoco":
            raise ImportError(f"{name} is hidden in this process")


sys.meta_path.insert(0, Hidden())
assert not [name for name in sys.modules if name.startswith(("rcmservo.sim", "mujoco"))]

WATCHDOG_NS = 1_000_000_000
"""Time in ns without a command after which this arm stops; a busy computer may stall."""

START, GOAL = np.array([0.6, 0.2, 120.0]), np.array([0.7, 0.35, 130.0])


class OwnArm:
    """Joints that follow at once; time and q are in memory that the camera reads."""

    def __init__(self, shared):
        self.shared = np.frombuffer(shared)
        self.rates, self.enabled, self.last_command = np.zeros(3), False, 0
        self.place(START)

    def place(self, q):
        """Move the tool by hand."""
        self.shared[:] = time.monotonic_ns(), *q

    def enable(self):
        self.rates, self.enabled, self.last_command = np.zeros(3), True, time.monotonic_ns()

    def measure(self):
        now = time.monotonic_ns()
        if now > self.last_command + WATCHDOG_NS:
            self.rates, self.enabled = np.zeros(3), False
        q = self.shared[1:] + self.rates * (now - self.shared[0]) * 1e-9
        self.shared[:] = now, *q
        return rs.ArmMeasurement(now, q, self.enabled)

    def apply(self, command):
        self.measure()
        self.last_command, self.enabled = time.monotonic_ns(), self.enabled and command.enabled
        self.rates = command.rates * self.enabled
        return self.rates.copy()


class OwnCamera:
    """Camera with thirty small images per second of a green and a blue disc on grey."""

    def __init__(self, shared):
        self.shared, self.frame = np.frombuffer(shared), None
        tool = tool_at(START)
        self.position = tool.mean(axis=0) + 350.0 * np.array([-0.7, -0.6, -0.2])
        forward = (tool.mean(axis=0) - self.position) / np.linalg.norm(
            tool.mean(axis=0) - self.position
        )
        right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
        self.rotation = np.stack([right, np.cross(forward, right), forward])

    def latest(self):
        exposure, *q = self.shared.copy()
        if self.frame is None or exposure - self.frame.exposure > 30_000_000:
            number = 0 if self.frame is None else self.frame.number + 1
            image = self.render(np.array(q))
            self.frame = rs.Frame(number, int(exposure), time.monotonic_ns(), image=image)
        return self.frame

    def render(self, q):
        image = np.full((120, 160, 3), 90, np.uint8)
        v, u = np.mgrid[0:120, 0:160]
        for p, paint in zip(tool_at(q), ([40, 190, 40], [200, 60, 20]), strict=True):
            x, y, z = self.rotation @ (p - self.position)
            distance = np.hypot(u - 200.0 * x / z - 80.0, v - 200.0 * y / z - 60.0)
            cover = np.clip(8.0 * 200.0 / z - distance + 0.5, 0.0, 1.0)[..., None]
            image = np.uint8(np.round(cover * paint + (1.0 - cover) * image))
        return image


def tool_at(q):
    """Return both markers (2, 3) in mm by eq. (2) and a rigid tool, computed independently."""
    theta, phi, rho = q
    direction = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    return np.outer([rho, rho + 30.0], direction)


def own_arm(shared):
    """Make the arm; fail if the simulator can be imported."""
    try:
        import rcmservo.sim  # noqa: F401
    except ImportError:
        return OwnArm(shared)
    raise AssertionError("the simulator can be imported in the servo process")


def teach_goal(plant):
    """Teach the goal and return the tool to its start."""
    plant.arm.place(GOAL)
    target = rs.teach(plant, frames=10)
    plant.arm.place(START)
    return target


class ScriptedOperator:
    """Operator who pauses and resumes, slows down, retargets and teaches, in this order.

    Each request follows a period of servoing. The operator also resumes after any other stop, and
    sets ``done`` once the servo runs again.
    """

    def __init__(self, slow: rs.Servo, done: Any) -> None:
        self.requests: list[OperatorRequest] = [rs.Request.PAUSE, slow, rs.Teach(frames=5)]
        self.servoed, self.done = 0, done

    def __call__(self, tick: rs.Tick) -> OperatorRequest:
        state = tick.state
        self.servoed += state.phase is rs.Phase.SERVO
        taught = len(self.requests) > 0 or state.target.taught_at > tick.observation.now - tick.time
        if state.phase is rs.Phase.PAUSED and not state.command.rates.any() and taught:
            return rs.Request.RESUME
        if self.servoed >= 15 and self.requests:
            self.servoed = 0
            return self.requests.pop(0)
        self.done.value = self.servoed >= 15
        return rs.Request.NONE


def make_operator(servo: rs.Servo, done: Any) -> Operator:
    return ScriptedOperator(servo, done)


def own_servo(gain: float = 2.0) -> rs.Servo:
    tolerant = rs.Thresholds(
        max_tick_delay=1.0,
        max_latency=1.0,
        max_frame_age_slow=50.0,
        max_frame_age_hold=50.0,
        arm_timeout=1.0,
    )
    law = rs.SaturatedController(gain=gain)
    return rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0), controller=law, thresholds=tolerant)


def session(record: Path, seconds: float, done: Any) -> Session:
    """Return a live session of the two devices with an operator."""
    shared = get_context("spawn").RawArray("d", 4)
    return Session(
        own_servo(),
        seconds,
        LazyRig(
            partial(own_arm, shared),
            partial(OwnCamera, shared),
            ColourMarkers,
            rs.SphericalRcm(),
            rs.RigidTool(30.0),
        ),
        target=teach_goal,
        recorder=partial(Recorder, record, {}),
        operator=partial(make_operator, own_servo(gain=1.0), done),
    )
