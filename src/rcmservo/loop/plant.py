"""An arm, a camera, a tracker and a clock as one thing that is read and sent to."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.errors import BadInput, RcmServoError
from rcmservo.guard.plausible import NO_PIXEL
from rcmservo.interfaces import (
    Arm,
    Camera,
    Clock,
    Command,
    Dropped,
    Floats,
    Frame,
    Markers,
    Measured,
    Observation,
    Tracker,
)
from rcmservo.loop.first_answer import look_at
from rcmservo.loop.joint_history import JointHistory

JOINT_HISTORY = 256
"""Measurements of the joints that are stored."""

OLDEST = 2_000_000_000
"""ns after its exposure within which a frame must arrive, or its time cannot be right."""


ENABLE_TIME = 2.0
"""s after an arm's first `enable` within which it must tell that its drive is on."""

ENABLE_POLL = 5_000_000
"""ns from asking to asking meanwhile."""


class NotEnabled(RcmServoError):
    """An arm whose drive does not come on."""


class Plant:
    """An arm, a camera and a tracker as one thing that is read and sent to.

    It keeps the joints' recent past, to tell where they were when a frame was exposed, and drops
    frames that are not new, that bear impossible times or that are damaged. What a device answers
    first is looked at: one that answers something else is told so in one sentence. ``recorded``
    tells whether a record that was asked for is still written.
    """

    def __init__(
        self,
        arm: Arm,
        camera: Camera,
        tracker: Tracker,
        clock: Clock,
        recorded: Callable[[], bool] = lambda: True,
    ) -> None:
        self.arm, self.camera, self.tracker, self.clock = arm, camera, tracker, clock
        self.recorded = recorded
        self.markers: Markers | None = None
        self.frame: Frame | None = None
        self._new = {"measure", "apply", "latest", "find"}
        self._offered: Frame | None = None
        self._dropped = Dropped.NONE
        self._joints = JointHistory(JOINT_HISTORY)
        self._began = np.inf
        self._sizes, self._quality = np.full(2, np.nan), np.full(2, np.nan)
        self._q_exposure = np.full(3, np.nan)
        self._applied = np.zeros(3)

    def enable(self) -> None:
        """Switch the arm's drive on: a person's act. Wait until it is on."""
        self.arm.enable()
        self._await_drive()

    def read(self) -> Observation:
        """Measure the joints, and track the markers where a new frame has arrived."""
        time, q, enabled = self._measure()
        q = q.copy()  # a device may fill one array again and again
        self._joints.add(time, q)
        if self._began == np.inf:
            self._began = time
        self._look(self._latest())
        frame = self.frame
        return Observation(
            now=self.clock.now(),
            q=q,
            q_time=time,
            enabled=enabled,
            applied=self._applied,
            frame=-1 if frame is None else frame.number,
            exposure=0 if frame is None else frame.exposure,
            arrival=0 if frame is None else frame.arrival,
            q_exposure=self._q_exposure,
            points=np.full((2, 2), np.nan) if self.markers is None else self.markers.points,
            dropped=self._dropped,
            recorded=self.recorded(),
            sizes=self._sizes,
            quality=self._quality,
        )

    def reset(self) -> None:
        """Forget where markers and joints were: a person may have moved the tool since they were
        last read.

        Frames exposed before the joints are read again count for nothing, and their numbers may
        begin anew.
        """
        self.tracker.reset()
        self._joints.clear()
        self._began = np.inf
        self.markers = self.frame = None
        self._dropped = Dropped.NONE
        self._sizes, self._quality = np.full(2, np.nan), np.full(2, np.nan)
        self._q_exposure = np.full(3, np.nan)

    def send(self, command: Command) -> Floats:
        """Pass a command on to the arm; the joint rates (3,) that the arm took."""
        self._applied = self.arm.apply(command)
        if "apply" in self._new:
            self._meet(self.arm, "apply", self._applied)
        self._applied = self._applied.copy()
        return self._applied

    def _measure(self) -> Measured:
        measured = self.arm.measure()
        if "measure" in self._new:
            self._meet(self.arm, "measure", measured)
        return measured

    def _latest(self) -> Frame | None:
        frame = self.camera.latest()
        if "latest" in self._new and frame is not None:
            self._meet(self.camera, "latest", frame)
        return frame

    def _meet(self, device: object, method: str, answer: object) -> None:
        """Look at a device's first answer; the next ones are taken as they are."""
        look_at(device, method, answer)
        self._new.remove(method)

    def _await_drive(self) -> None:
        end = self.clock.now() + round(ENABLE_TIME * 1e9)
        while not self._measure().enabled:
            if self.clock.now() >= end:
                raise self._not_enabled()
            self.clock.wait_until(self.clock.now() + ENABLE_POLL)

    def _not_enabled(self) -> NotEnabled:
        name = type(self.arm).__name__
        return NotEnabled(
            f"{name}.measure() must tell enabled = True within {ENABLE_TIME:g} s after "
            f"{name}.enable(), got False: the drive does not come on"
        )

    def _look(self, frame: Frame | None) -> None:
        """Track the markers in a frame that was not offered before, or say why not."""
        if frame is None or frame is self._offered:
            return
        self._offered = frame
        self._dropped = self._wrong(frame)
        if self._dropped is not Dropped.NONE or frame.exposure < self._began:
            return
        try:
            markers = self.tracker.find(frame)
        except BadInput:
            self._dropped = Dropped.DAMAGED
            return
        if "find" in self._new:
            self._meet(self.tracker, "find", markers)
        self.markers, self.frame = replace(markers, points=_points(markers)), frame
        self._sizes, self._quality = _sizes(self.markers), _quality(self.markers)
        known = frame.exposure >= self._joints.oldest
        self._q_exposure = self._joints.at(frame.exposure) if known else np.full(3, np.nan)

    def _wrong(self, frame: Frame) -> Dropped:
        if (
            not 0 <= frame.arrival - frame.exposure <= OLDEST
            or not 0 <= self.clock.now() - frame.arrival <= OLDEST
        ):
            return Dropped.CLOCK
        last = self.frame
        if last is not None and not frame.number > last.number:
            return Dropped.NOT_NEW
        if last is not None and not frame.exposure > last.exposure:
            return Dropped.CLOCK
        return Dropped.NONE if last is None or _shape(frame) == _shape(last) else Dropped.DAMAGED


def _points(markers: Markers) -> Floats:
    """The markers (2, 2) raw px, NaN for one that is where no camera has a pixel: what is learnt
    from would take any other number for a place."""
    seen = (np.abs(markers.points) < NO_PIXEL).all(axis=1, keepdims=True)
    return np.where(seen, markers.points, np.nan)


def _sizes(markers: Markers) -> Floats:
    """The markers' apparent radii (2,) px, NaN for one that is lost."""
    seen = np.isfinite(markers.points).all(axis=1)
    return np.where(seen, markers.radius, np.nan)


def _quality(markers: Markers) -> Floats:
    """How well the markers were seen (2,), 0 for one that is lost; NaN of a tracker that tells none
    of use."""
    seen = np.isfinite(markers.points).all(axis=1)
    told = np.asarray(markers.quality, dtype=np.float64)
    return np.where(seen, told, 0.0) if told.shape == (2,) else np.full(2, np.nan)


def _shape(frame: Frame) -> tuple[int, ...] | None:
    return None if frame.image is None else frame.image.shape
