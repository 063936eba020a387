"""Simulated camera as a separate process, so that rendering delays neither arm nor servo."""

import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Floats, Frame
from rcmservo.live.child_process import receive_from_parent
from rcmservo.live.frame_ring import FrameRing
from rcmservo.loop.clock import sleep_until
from rcmservo.loop.joint_history import JointHistory
from rcmservo.sim.arm import HISTORY_STEPS
from rcmservo.sim.disturbances.effects.frame_delivery import FrameDelivery
from rcmservo.sim.processes.live_disturbances import DisturbanceChange
from rcmservo.sim.processes.motion_log import MotionLog
from rcmservo.sim.rig import RigSettings, SimulatedRig

LOG_DELAY_NS = 2_000_000
"""Time (ns) after the end of an exposure by which the arm's log contains it."""

FIRST_ROW_POLL_S = 0.002
"""Time (s) between two looks whether the arm has begun its log."""


class LoggedArm:
    """Arm in another process, whose joints are read from its motion log.

    Parameters
    ----------
    log : MotionLog
        Log of the arm's motion.
    """

    time: int
    """Time (ns) at which the camera looks at the arm."""

    def __init__(self, log: MotionLog) -> None:
        self.time, self.log = 0, log
        self._history, self._rows_read = JointHistory(HISTORY_STEPS), 0

    def joints_at(self, time: int) -> Floats:
        """Return the joints (3,) at a time (ns) within the last second."""
        row_count = self.log.count
        for row in self.log.since(max(self._rows_read, row_count - HISTORY_STEPS)):
            self._history.add(int(row["time"]), row["q"])
        self._rows_read = row_count
        return self._history.interpolate(time)


def run_camera_process(
    seed: int, settings: RigSettings, log: MotionLog, ring: FrameRing, control: Connection
) -> None:
    """Publish frames at the camera's rate until the parent process sends "end" or closes `control`.

    It sends "ready" before the first frame, or the error that prevents the start. It skips a frame
    that would be late because rendering the previous one took too long.

    Parameters
    ----------
    seed : int
        Seed of the laboratory.
    settings : RigSettings
        Parts of the laboratory.
    log : MotionLog
        Log of the arm's motion.
    ring : FrameRing
        Ring buffer to which the frames are written.
    control : multiprocessing.connection.Connection
        Connection to the parent process.
    """
    try:
        rig, arm = SimulatedRig(seed, settings), LoggedArm(log)
    except RcmServoError as error:
        control.send(RcmServoError(str(error)))
        return
    while not log.count:  # the arm starts at the same time
        if control.poll(FIRST_ROW_POLL_S):
            return
    timing = settings.timing
    period_ns, half_exposure_ns = 1e9 / timing.frame_rate, round(0.5e9 * timing.exposure)
    latency_ns = half_exposure_ns + round(1e9 * timing.delay)
    ready_delay_ns = half_exposure_ns + LOG_DELAY_NS
    number = int((time.monotonic_ns() - half_exposure_ns) / period_ns)
    arm.time = round(number * period_ns) + latency_ns
    rig.accept_live_disturbances(arm)
    delivery = rig.camera
    assert isinstance(delivery, FrameDelivery)
    camera = FrameDelivery(delivery.camera, time.monotonic_ns, rig.schedule)
    camera.latest()
    control.send("ready")
    published_frame: Frame | None = None
    message: Any = ""
    while message != "end":
        ready_time = round(number * period_ns) + ready_delay_ns
        due_time = camera.due
        sleep_until(ready_time if due_time is None else min(ready_time, due_time))
        if time.monotonic_ns() >= ready_time:
            arm.time = round(number * period_ns) + latency_ns
            number = max(number + 1, int((time.monotonic_ns() - ready_delay_ns) / period_ns))
        frame, now = camera.latest(), time.monotonic_ns()
        if frame is not None and frame is not published_frame:
            published_frame = frame
            ring.publish(replace(frame, arrival=frame.arrival + now - camera.newest_arrival))
        message = receive_from_parent(control) if control.poll() else ""
        if isinstance(message, DisturbanceChange):
            message.apply(rig.schedule)
