"""The simulated camera as a process of its own, so that rendering holds up neither the arm nor the
servo."""

import time
from collections import deque
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np

from rcmservo.interfaces import Frame
from rcmservo.live.frame_ring import FrameRing
from rcmservo.loop.clock import sleep_until
from rcmservo.sim.cameras import BLUR, PictureCamera, moments
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import Rig, RigSettings

BEHIND = 2_000_000
"""ns after the end of an exposure at which the arm's log is sure to hold it."""


def film(
    seed: int, settings: RigSettings, log: MotionLog, ring: FrameRing, control: Connection
) -> None:
    """Publish frame after frame at the camera's pace until the other end of `control` speaks or is
    gone.

    It says "ready" once it can. A frame that would come too late because the one before took long
    is left out.
    """
    camera = Rig(seed, settings).camera
    assert isinstance(camera, PictureCamera)
    timing, home = settings.timing, np.stack([camera.body.points(log.joints_at(0))] * BLUR)
    camera.renderer.render(home, 0)
    control.send("ready")
    period, half = 1e9 / timing.frame_rate, round(0.5e9 * timing.exposure)
    under_way: deque[Frame] = deque()
    number = int((time.monotonic_ns() - half) / period)
    while not control.poll():
        exposure = round(number * period)
        ready = exposure + half + BEHIND
        if under_way and under_way[0].arrival <= ready:
            frame = under_way.popleft()
            sleep_until(frame.arrival)
            ring.publish(replace(frame, arrival=time.monotonic_ns()))
            continue
        sleep_until(ready)
        times = moments(exposure, timing.exposure, BLUR)
        poses = np.stack([camera.body.points(log.joints_at(t)) for t in times])
        image = camera.renderer.render(poses, number)
        under_way.append(
            Frame(number, exposure, exposure + half + round(1e9 * timing.delay), image=image)
        )
        number = max(number + 1, int((time.monotonic_ns() - half - BEHIND) / period))
