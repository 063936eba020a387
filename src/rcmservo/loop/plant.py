"""Plant: arm, camera, tracker and clock behind one interface with `read` and `send`."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.errors import BadInput, RcmServoError
from rcmservo.interfaces import (
    Arm,
    ArmMeasurement,
    Camera,
    Clock,
    Command,
    DropReason,
    Floats,
    Frame,
    Markers,
    Observation,
    Tracker,
)
from rcmservo.loop.device_checks import check_first_value
from rcmservo.loop.joint_history import JointHistory
from rcmservo.safety.innovation import MAX_PIXEL_COORDINATE

JOINT_HISTORY = 256
"""Number of joint measurements that the plant stores."""

MAX_FRAME_AGE_NS = 2_000_000_000
"""Largest plausible time in ns from a frame's exposure to its arrival, and from there to now."""


ENABLE_TIMEOUT_S = 2.0
"""Time in s after `Arm.enable` within which the arm must report that its drive is on."""

ENABLE_POLL_NS = 5_000_000
"""Interval in ns at which the state of the drive is read meanwhile."""


class NotEnabled(RcmServoError):
    """Error of an arm whose drive does not come on."""


class Plant:
    """Arm, camera, tracker and clock behind one interface.

    The plant stores recent joint values to interpolate them at the exposure of a frame. It drops
    frames that are not new, damaged or have impossible times. It checks the first value that each
    method of a device returns.

    Parameters
    ----------
    arm : Arm
        Arm with velocity drives.
    camera : Camera
        Source of the frames.
    tracker : Tracker
        Detector of the markers.
    clock : Clock
        Clock of all times.
    recorded : Callable
        Function that returns False once a requested record is no longer written.

    Raises
    ------
    BadInput
        At the first call, if a device returns a value of another type or shape than its protocol.
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
        self._unchecked = {"measure", "apply", "latest", "find"}
        self._newest: Frame | None = None
        self._dropped = DropReason.NONE
        self._joints = JointHistory(JOINT_HISTORY)
        self._valid_from = np.inf
        self._sizes, self._quality = np.full(2, np.nan), np.full(2, np.nan)
        self._q_exposure = np.full(3, np.nan)
        self._applied = np.zeros(3)

    def enable(self) -> None:
        """Enable the arm's drive and wait until it is on. A user's action causes it.

        Raises
        ------
        NotEnabled
            If the arm does not report the drive as on within 2 s.
        """
        self.arm.enable()
        self._await_drive()

    def read(self) -> Observation:
        """Return an observation: read the joints, and track the markers if a new frame arrived."""
        time, q, enabled = self._measure()
        q = q.copy()  # a device may reuse one array
        self._joints.add(time, q)
        if self._valid_from == np.inf:
            self._valid_from = time
        self._track(self._latest())
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
            drop_reason=self._dropped,
            recorded=self.recorded(),
            sizes=self._sizes,
            quality=self._quality,
        )

    def reset(self) -> None:
        """Discard markers and joint history, as the tool may have been moved since.

        Frames that were exposed before the next reading of the joints are ignored, and frame
        numbers may restart.
        """
        self.tracker.reset()
        self._joints.clear()
        self._valid_from = np.inf
        self.markers = self.frame = None
        self._dropped = DropReason.NONE
        self._sizes, self._quality = np.full(2, np.nan), np.full(2, np.nan)
        self._q_exposure = np.full(3, np.nan)

    def send(self, command: Command) -> Floats:
        """Send a command to the arm and return the joint rates (3,) that it applies."""
        self._applied = self.arm.apply(command)
        if "apply" in self._unchecked:
            self._check_first(self.arm, "apply", self._applied)
        self._applied = self._applied.copy()
        return self._applied

    def _measure(self) -> ArmMeasurement:
        measured = self.arm.measure()
        if "measure" in self._unchecked:
            self._check_first(self.arm, "measure", measured)
        return measured

    def _latest(self) -> Frame | None:
        frame = self.camera.latest()
        if "latest" in self._unchecked and frame is not None:
            self._check_first(self.camera, "latest", frame)
        return frame

    def _check_first(self, device: object, method: str, answer: object) -> None:
        """Check the first value that a method returns; later ones are not checked."""
        check_first_value(device, method, answer)
        self._unchecked.remove(method)

    def _await_drive(self) -> None:
        end = self.clock.now() + round(ENABLE_TIMEOUT_S * 1e9)
        while not self._measure().enabled:
            if self.clock.now() >= end:
                raise self._not_enabled()
            self.clock.wait_until(self.clock.now() + ENABLE_POLL_NS)

    def _not_enabled(self) -> NotEnabled:
        name = type(self.arm).__name__
        return NotEnabled(
            f"{name}.measure() must report enabled = True within {ENABLE_TIMEOUT_S:g} s after "
            f"{name}.enable(), got False: the drive does not come on"
        )

    def _track(self, frame: Frame | None) -> None:
        """Track the markers in a new frame, or record the reason for dropping it."""
        if frame is None or frame is self._newest:
            return
        self._newest = frame
        self._dropped = self._defect(frame)
        if self._dropped is not DropReason.NONE or frame.exposure < self._valid_from:
            return
        try:
            markers = self.tracker.find(frame)
        except BadInput:
            self._dropped = DropReason.DAMAGED
            return
        if "find" in self._unchecked:
            self._check_first(self.tracker, "find", markers)
        self.markers, self.frame = replace(markers, points=_points(markers)), frame
        self._sizes, self._quality = _sizes(self.markers), _quality(self.markers)
        known = frame.exposure >= self._joints.oldest
        self._q_exposure = self._joints.at(frame.exposure) if known else np.full(3, np.nan)

    def _defect(self, frame: Frame) -> DropReason:
        """Return the reason for not using a frame; NONE if it is usable."""
        if (
            not 0 <= frame.arrival - frame.exposure <= MAX_FRAME_AGE_NS
            or not 0 <= self.clock.now() - frame.arrival <= MAX_FRAME_AGE_NS
        ):
            return DropReason.CLOCK
        last = self.frame
        if last is not None and not frame.number > last.number:
            return DropReason.NOT_NEW
        if last is not None and not frame.exposure > last.exposure:
            return DropReason.CLOCK
        return (
            DropReason.NONE if last is None or _shape(frame) == _shape(last) else DropReason.DAMAGED
        )


def _points(markers: Markers) -> Floats:
    """Return the raw markers (2, 2) in px, NaN for one outside any possible image.

    Estimators would use every finite number.
    """
    possible = (np.abs(markers.points) < MAX_PIXEL_COORDINATE).all(axis=1, keepdims=True)
    return np.where(possible, markers.points, np.nan)


def _sizes(markers: Markers) -> Floats:
    """Return the apparent radii (2,) in px, NaN for a lost marker."""
    detected = np.isfinite(markers.points).all(axis=1)
    return np.where(detected, markers.radius, np.nan)


def _quality(markers: Markers) -> Floats:
    """Return the detection quality (2,), 0 for a lost marker; NaN if the tracker reports none."""
    detected = np.isfinite(markers.points).all(axis=1)
    quality = np.asarray(markers.quality, dtype=np.float64)
    return np.where(detected, quality, 0.0) if quality.shape == (2,) else np.full(2, np.nan)


def _shape(frame: Frame) -> tuple[int, ...] | None:
    return None if frame.image is None else frame.image.shape
