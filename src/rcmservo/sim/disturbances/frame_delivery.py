"""Faulty delivery of frames: late, repeated, out of order, damaged or lost."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from rcmservo.interfaces import Camera, Frame
from rcmservo.sim.disturbances.frame_damage import damage
from rcmservo.sim.disturbances.schedule import Schedule

OVERTAKING_DELAY_NS = 5_000_000
"""Delay (ns) of a frame after the frame that overtakes it."""


class FrameDelivery:
    """Camera with a faulty connection. The time of a frame's undisturbed arrival decides its fate.

    Parameters
    ----------
    camera : Camera
        Camera with a faultless connection.
    now : callable
        Returns the present time, ns.
    schedule : Schedule
        Disturbances with their times.
    """

    def __init__(self, camera: Camera, now: Callable[[], int], schedule: Schedule) -> None:
        self.camera, self.now, self.schedule = camera, now, schedule
        self._raw: Frame | None = None
        self._frame: Frame | None = None
        self._previous: Frame | None = None
        self._held: Frame | None = None
        self._in_transit: deque[tuple[int, Frame]] = deque()
        self.newest_arrival = 0
        """Scheduled arrival of the newest frame, ns."""

    @property
    def due(self) -> int | None:
        """Arrival (ns) of the next frame; None if no frame is in transit."""
        return self._in_transit[0][0] if self._in_transit else None

    def latest(self) -> Frame | None:
        raw = self.camera.latest()
        if raw is not None and raw is not self._raw:
            self._raw = raw
            self._handle(raw)
        while self._in_transit and self._in_transit[0][0] <= self.now():
            self.newest_arrival, self._frame = self._in_transit.popleft()
        return self._frame

    def _handle(self, frame: Frame) -> None:
        """Lose, repeat, damage, hold or schedule a frame."""
        time = frame.arrival
        if self._is_lost(time):
            return
        faults = {event.word("what") for event in self.schedule.active(time, "frame_order")}
        if "repeated" in faults and self._previous is not None:
            frame = replace(self._previous, arrival=time)
        self._previous = frame
        for event in self.schedule.active(time, "corrupt"):
            frame = damage(frame, event.word("what"), event.random)
        if "swapped" in faults and self._held is None:
            self._held = frame
            return
        self._schedule_arrival(frame, time)
        if self._held is not None:
            self._schedule_arrival(self._held, time + OVERTAKING_DELAY_NS)
            self._held = None

    def _is_lost(self, time: int) -> bool:
        lost = [
            event.random.uniform() < event.number("share")
            for event in self.schedule.active(time, "frame_drop")
        ]
        return any(lost)

    def _schedule_arrival(self, frame: Frame, time: int) -> None:
        """Schedule the arrival of a frame that leaves the camera at `time` (ns).

        No frame overtakes another one. Its time stamps are those of the camera's clock.
        """
        delay = 0.0
        for event in self.schedule.active(time, "latency"):
            delay += event.number("s") + event.number("jitter") * event.random.uniform()
        arrival = max(time + round(delay * 1e9), self._in_transit[-1][0] if self._in_transit else 0)
        exposed, arrived = frame.exposure, arrival
        for event in self.schedule.active(time, "camera_clock"):
            ahead = round(event.number("s") * 1e9)
            exposed += ahead
            arrived += ahead if event.word("of") == "all" else 0
        self._in_transit.append((arrival, replace(frame, exposure=exposed, arrival=arrived)))
