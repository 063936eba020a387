"""Frames that come from the camera late, again, out of order, damaged, or never."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from rcmservo.interfaces import Camera, Frame
from rcmservo.sim.disturbances.frame_damage import damaged
from rcmservo.sim.disturbances.schedule import Schedule

OVERTAKEN = 5_000_000
"""ns by which a frame comes after the one that has overtaken it."""


class Delivery:
    """A camera with a bad connection. What happens to a frame is decided when it would arrive."""

    def __init__(self, camera: Camera, now: Callable[[], int], schedule: Schedule) -> None:
        self.camera, self.now, self.schedule = camera, now, schedule
        self._raw: Frame | None = None
        self._frame: Frame | None = None
        self._again: Frame | None = None
        self._held: Frame | None = None
        self._coming: deque[tuple[int, Frame]] = deque()
        self.came = 0
        """Time at which the newest frame was to come, ns."""

    @property
    def due(self) -> int | None:
        """Time at which the next frame comes, ns; None where none is on its way."""
        return self._coming[0][0] if self._coming else None

    def latest(self) -> Frame | None:
        raw = self.camera.latest()
        if raw is not None and raw is not self._raw:
            self._raw = raw
            self._pass(raw)
        while self._coming and self._coming[0][0] <= self.now():
            self.came, self._frame = self._coming.popleft()
        return self._frame

    def _pass(self, frame: Frame) -> None:
        """Decide what becomes of a frame, and when it comes."""
        time = frame.arrival
        if self._lost(time):
            return
        orders = {event.word("what") for event in self.schedule.acting(time, "frame_order")}
        if "repeated" in orders and self._again is not None:
            frame = replace(self._again, arrival=time)
        self._again = frame
        for event in self.schedule.acting(time, "corrupt"):
            frame = damaged(frame, event.word("what"), event.random)
        if "swapped" in orders and self._held is None:
            self._held = frame
            return
        self._send(frame, time)
        if self._held is not None:
            self._send(self._held, time + OVERTAKEN)
            self._held = None

    def _lost(self, time: int) -> bool:
        drawn = [
            event.random.uniform() < event.number("share")
            for event in self.schedule.acting(time, "frame_drop")
        ]
        return any(drawn)

    def _send(self, frame: Frame, time: int) -> None:
        """Send a frame on its way at `time` ns. No frame overtakes another one.

        Its stamps are those of the camera's clock.
        """
        late = 0.0
        for event in self.schedule.acting(time, "latency"):
            late += event.number("s") + event.number("jitter") * event.random.uniform()
        arrival = max(time + round(late * 1e9), self._coming[-1][0] if self._coming else 0)
        exposed, arrived = frame.exposure, arrival
        for event in self.schedule.acting(time, "camera_clock"):
            ahead = round(event.number("s") * 1e9)
            exposed += ahead
            arrived += ahead if event.word("of") == "all" else 0
        self._coming.append((arrival, replace(frame, exposure=exposed, arrival=arrived)))
