"""Faulty delivery of frames: late, repeated, out of order, damaged or lost."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from rcmservo.interfaces import Camera, Frame
from rcmservo.sim.disturbances.effects.frame_damage import damage_frame
from rcmservo.sim.disturbances.schedule import Schedule

OVERTAKING_DELAY_NS = 5_000_000
"""Delay (ns) of a frame after the frame that overtakes it."""


class FrameDelivery:
    """Camera with a faulty connection.

    A disturbance acts on a frame if it is active when the frame would arrive without a fault.

    Parameters
    ----------
    camera : Camera
        Camera with a faultless connection.
    now : callable
        Returns the present time, ns.
    schedule : Schedule
        Disturbances with their times.
    """

    newest_arrival: int
    """Time (ns) at which the newest frame has arrived."""

    def __init__(self, camera: Camera, now: Callable[[], int], schedule: Schedule) -> None:
        self.camera, self.now, self.schedule = camera, now, schedule
        self.newest_arrival = 0
        self._last_camera_frame: Frame | None = None
        self._arrived_frame: Frame | None = None
        self._previous_frame: Frame | None = None
        self._overtaken_frame: Frame | None = None
        self._in_transit: deque[tuple[int, Frame]] = deque()

    @property
    def due(self) -> int | None:
        """Arrival (ns) of the next frame; None if no frame is in transit."""
        return self._in_transit[0][0] if self._in_transit else None

    def latest(self) -> Frame | None:
        """Return the newest frame that has arrived; None before the first one."""
        frame = self.camera.latest()
        if frame is not None and frame is not self._last_camera_frame:
            self._last_camera_frame = frame
            self._send(frame)
        while self._in_transit and self._in_transit[0][0] <= self.now():
            self.newest_arrival, self._arrived_frame = self._in_transit.popleft()
        return self._arrived_frame

    def _send(self, frame: Frame) -> None:
        """Lose, repeat or damage a frame, and schedule its arrival or hold it to be overtaken."""
        time = frame.arrival
        if self._is_lost(time):
            return
        order_faults = {event.word("what") for event in self.schedule.active(time, "frame_order")}
        if "repeated" in order_faults and self._previous_frame is not None:
            frame = replace(self._previous_frame, arrival=time)
        self._previous_frame = frame
        for event in self.schedule.active(time, "corrupt"):
            frame = damage_frame(frame, event.word("what"), event.random)
        if "swapped" in order_faults and self._overtaken_frame is None:
            self._overtaken_frame = frame
            return
        self._schedule_arrival(frame, time)
        if self._overtaken_frame is not None:
            self._schedule_arrival(self._overtaken_frame, time + OVERTAKING_DELAY_NS)
            self._overtaken_frame = None

    def _is_lost(self, time: int) -> bool:
        """Return True if a frame is lost.

        Every disturbance draws a number for it, also after another has lost the frame, so that
        their random sequences stay independent.
        """
        events = self.schedule.active(time, "frame_drop")
        return any([event.random.uniform() < event.number("share") for event in events])

    def _schedule_arrival(self, frame: Frame, time: int) -> None:
        """Schedule the arrival of a frame that would arrive at `time` (ns) without latency.

        Latency keeps the order of the frames. The time stamps are those of the camera's clock.
        """
        delay_s = 0.0
        for event in self.schedule.active(time, "latency"):
            delay_s += event.number("s") + event.number("jitter") * event.random.uniform()
        earliest_arrival = self._in_transit[-1][0] if self._in_transit else 0
        arrival = max(time + round(delay_s * 1e9), earliest_arrival)
        exposure_stamp, arrival_stamp = frame.exposure, arrival
        for event in self.schedule.active(time, "camera_clock"):
            clock_error = round(event.number("s") * 1e9)
            exposure_stamp += clock_error
            arrival_stamp += clock_error if event.word("of") == "all" else 0
        stamped = replace(frame, exposure=exposure_stamp, arrival=arrival_stamp)
        self._in_transit.append((arrival, stamped))
