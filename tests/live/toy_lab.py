"""Servo on the toy arm of examples/udp_arm, with a camera that delivers points.

Run as `toy_lab.py PORT SECONDS`; it prints the final phase and joints.
"""

import socket
import sys
import time

import numpy as np
from toy_arm import START
from toy_wire import ASK, ToyOrder, answer_in, sent
from udp_arm import UdpArm

import rcmservo as rs
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.tracking import PointMarkers

GOAL = 0.75, 0.4, 135.0
TOLERANT = rs.Thresholds(
    max_tick_delay=1.0,
    max_latency=1.0,
    max_frame_age_slow=50.0,
    max_frame_age_hold=50.0,
    arm_timeout=1.0,
)
"""Tolerant thresholds for a busy computer; the toy's own watchdog is not tolerant.
"""


def tool_at(q):
    """Return both markers (2, 3) in mm by eq. (2) and a rigid tool, computed independently."""
    theta, phi, rho = q
    direction = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    return np.outer([rho, rho + 30.0], direction)


class ToyCamera:
    """Camera that computes the marker points sixty times a second from the toy's joints."""

    def __init__(self, port):
        self.wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.wire.connect(("127.0.0.1", port))
        self.wire.setblocking(False)
        self.random, self.frame, self.requested = np.random.default_rng(0), None, 0
        middle = tool_at(START).mean(axis=0)
        self.position = middle + 350.0 * np.array([-0.7, -0.6, -0.2])
        forward = (middle - self.position) / np.linalg.norm(middle - self.position)
        right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
        self.rotation = np.stack([right, np.cross(forward, right), forward])

    def latest(self):
        now = time.monotonic_ns()
        if now > self.requested + 16_000_000:
            self.requested = now
            self.wire.send(sent(ToyOrder(ASK, 0, 0, now, (0.0, 0.0, 0.0))))
        try:
            answer = answer_in(self.wire.recv(512))
        except OSError:
            return self.frame
        number = 0 if self.frame is None else self.frame.number + 1
        points = self.project(answer.q) + 0.1 * self.random.standard_normal((2, 2))
        now = time.monotonic_ns()
        self.frame = rs.Frame(number, (answer.stamp + now) // 2, now, points=points)
        return self.frame

    def project(self, q):
        x, y, z = self.rotation @ (tool_at(q) - self.position).T
        return np.stack([800.0 * x / z + 320.0, 800.0 * y / z + 240.0], axis=1)


def resume(tick):
    """Resume after any pause, which a busy computer may cause."""
    still = not tick.state.command.rates.any()
    paused = tick.state.phase is rs.Phase.PAUSED and still
    return rs.Request.RESUME if paused else rs.Request.NONE


def main(port, seconds):
    arm, camera, clock = UdpArm("127.0.0.1", port), ToyCamera(port), rs.WallClock()
    servo = rs.Servo(rs.SphericalRcm(), rs.RigidTool(30.0), thresholds=TOLERANT)
    target = rs.Target(camera.project(GOAL), np.array(GOAL))
    servo.warm_up()
    with TrackingThread(camera, PointMarkers(), clock) as eye, apply_realtime_settings():
        plant = rs.Plant(arm, eye, eye, clock)
        for last in rs.servo_ticks(plant, servo, target, seconds, operator=resume):
            tick = last
    print(tick.state.phase.name, *(f"{q:.3f}" for q in arm.measure().q))
    arm.close()


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
