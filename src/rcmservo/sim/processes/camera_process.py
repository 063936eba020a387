"""The simulated camera as a process of its own, so that rendering holds up neither the arm nor the
servo."""

import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from rcmservo.interfaces import Floats, Frame
from rcmservo.live.child import heard
from rcmservo.live.frame_ring import FrameRing
from rcmservo.loop.clock import sleep_until
from rcmservo.loop.joint_history import JointHistory
from rcmservo.sim.arm import PAST
from rcmservo.sim.disturbances.frame_delivery import Delivery
from rcmservo.sim.processes.live_disturbances import Mischief
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import Rig, RigSettings

BEHIND = 2_000_000
"""ns after the end of an exposure at which the arm's log is sure to hold it."""


class Elsewhere:
    """The arm in its own process, as its log tells of it; `time` ns is when the camera looks."""

    def __init__(self, log: MotionLog) -> None:
        self.time, self.log = 0, log
        self._past, self._read = JointHistory(PAST), 0

    def joints_at(self, time: int) -> Floats:
        """The joints (3,) at a moment (ns) of the last second."""
        count = self.log.count
        for row in self.log.since(max(self._read, count - PAST)):
            self._past.add(int(row["time"]), row["q"])
        self._read = count
        return self._past.at(time)


def film(
    seed: int, settings: RigSettings, log: MotionLog, ring: FrameRing, control: Connection
) -> None:
    """Publish frame after frame at the camera's pace until the other end of `control` says "end" or
    is gone.

    It says "ready" once it can. A frame that would come too late because the one before took long
    is left out.
    """
    rig, arm = Rig(seed, settings), Elsewhere(log)
    timing = settings.timing
    period, half = 1e9 / timing.frame_rate, round(0.5e9 * timing.exposure)
    late = half + round(1e9 * timing.delay)
    number = int((time.monotonic_ns() - half) / period)
    arm.time = round(number * period) + late
    rig.open_to_trouble(arm)
    view = rig.camera
    assert isinstance(view, Delivery)
    camera = Delivery(view.camera, time.monotonic_ns, rig.schedule)
    camera.latest()
    control.send("ready")
    shown: Frame | None = None
    said: Any = ""
    while said != "end":
        ready = round(number * period) + half + BEHIND
        due = camera.due
        sleep_until(ready if due is None else min(ready, due))
        if time.monotonic_ns() >= ready:
            arm.time = round(number * period) + late
            number = max(number + 1, int((time.monotonic_ns() - half - BEHIND) / period))
        frame, now = camera.latest(), time.monotonic_ns()
        if frame is not None and frame is not shown:
            shown = frame
            ring.publish(replace(frame, arrival=frame.arrival + now - camera.came))
        said = heard(control) if control.poll() else ""
        if isinstance(said, Mischief):
            said.befalls(rig.schedule)
