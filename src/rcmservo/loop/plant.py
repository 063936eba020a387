"""Plant: arm, camera, tracker and clock behind one interface with `read` and `send`."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.errors import BadInput, RcmServoError
from rcmservo.interfaces import (
    NEVER_NS,
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

MAX_READING_GAP_NS = 80_000_000
"""Time in ns between two readings of the joints over which a motion may be interpolated."""

MAX_UNREAD_MOTION = np.array([0.005, 0.005, 0.5])
"""Motion of the joints in rad, rad, mm that counts as none."""

MAX_FRAME_AGE_NS = 2_000_000_000
"""Largest plausible time in ns from a frame's exposure to its arrival, and from there to now."""

FRAME_COUNTERS = (1 << 16, 1 << 31, 1 << 32)
"""Numbers of frames after which the frame number of some cameras starts again at zero."""

ENABLE_TIMEOUT_S = 2.0
"""Time in s after `Arm.enable` within which the arm must report that its drive is on."""

ENABLE_POLL_NS = 5_000_000
"""Interval in ns at which the state of the drive is read within this time."""


class NotEnabled(RcmServoError):
    """Error of an arm whose drive does not come on."""


class Plant:
    """Arm, camera, tracker and clock behind one interface: `read` observes, `send` commands.

    The plant stores recent joint values to interpolate them at the exposure of a frame. It ignores
    frames that were exposed before the first reading, or while the tool moved and nobody read the
    joints for more than 80 ms: it may have moved on any path meanwhile. It drops frames that are
    damaged, are not new, or have impossible times. A time is impossible if the frame arrived before
    its exposure or more than 2 s after it, if the arrival is in the future or more than 2 s ago, or
    if the exposure is not later than that of the previous frame. The plant checks the first value
    that each method of a device returns.

    Parameters
    ----------
    arm : Arm
        Arm that accepts joint rates.
    camera : Camera
        Source of the frames.
    tracker : Tracker
        Detector of the markers in a frame.
    clock : Clock
        Clock of all times, in ns.
    recorded : Callable
        Function that returns False once a requested record is no longer written. By default the
        result is always True.

    Raises
    ------
    BadInput
        At the first call, if a device returns a value of another type or shape than its protocol.

    Notes
    -----
    `enable` raises ``NotEnabled``, a class of the module `rcmservo.loop.plant`, if the drive does
    not come on.
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
        self.image_shape: tuple[int, ...] | None = None
        self._unchecked = {"measure", "apply", "latest", "find"}
        self._newest_frame: Frame | None = None
        self._joints = JointHistory(JOINT_HISTORY)
        self._applied = np.zeros(3)
        self._forget_frames()

    def _forget_frames(self) -> None:
        self.markers: Markers | None = None
        self.frame: Frame | None = None
        self._frame_number, self._last_reading = -1, (NEVER_NS, np.full(3, np.inf))
        self._drop_reason = DropReason.NONE
        self._valid_from = np.inf
        self._sizes, self._quality = np.full(2, np.nan), np.full(2, np.nan)
        self._q_exposure = np.full(3, np.nan)

    def enable(self) -> None:
        """Enable the arm's drive and wait until it is on.

        Call it only as a consequence of a user's action.

        Raises
        ------
        NotEnabled
            If the arm does not report the drive as on within 2 s.
        """
        self.arm.enable()
        end = self.clock.now() + round(ENABLE_TIMEOUT_S * 1e9)
        while not self._measure().enabled:
            if self.clock.now() >= end:
                name = type(self.arm).__name__
                raise NotEnabled(
                    f"{name}.measure() must report enabled = True within {ENABLE_TIMEOUT_S:g} s "
                    f"after {name}.enable(), got False: the drive does not come on"
                )
            self.clock.wait_until(self.clock.now() + ENABLE_POLL_NS)

    def read(self) -> Observation:
        """Return an observation: read the joints, and track the markers if a new frame arrived."""
        time, q, enabled = self._measure()
        q = q.copy()  # a device may reuse one array
        self._joints.add(time, q)
        now = self.clock.now()
        if self._has_moved_unread(now, q):
            self._valid_from = time
        self._last_reading = now, q
        newest_frame = self.camera.latest()
        if newest_frame is not None and newest_frame is not self._newest_frame:
            self._check_first(self.camera, "latest", newest_frame)
            self._newest_frame = newest_frame
            self._track(newest_frame)
        frame = self.frame
        return Observation(
            now=self.clock.now(),
            q=q,
            q_time=time,
            enabled=enabled,
            applied=self._applied,
            frame=self._frame_number,
            exposure=0 if frame is None else frame.exposure,
            arrival=0 if frame is None else frame.arrival,
            q_exposure=self._q_exposure,
            points=np.full((2, 2), np.nan) if self.markers is None else self.markers.points,
            drop_reason=self._drop_reason,
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
        self._forget_frames()

    def _has_moved_unread(self, now: int, q: Floats) -> bool:
        """Return True if the tool has moved to the joints q (3,) with no reading on the way."""
        last_time, last_q = self._last_reading
        has_moved = bool((np.abs(q - last_q) > MAX_UNREAD_MOTION).any())
        return has_moved and now - last_time > MAX_READING_GAP_NS

    def send(self, command: Command) -> Floats:
        """Send a command to the arm and return the joint rates that it applies.

        They are an array (3,) in rad/s, rad/s, mm/s.
        """
        applied = self.arm.apply(command)
        self._check_first(self.arm, "apply", applied)
        self._applied = applied.copy()
        return self._applied

    def _measure(self) -> ArmMeasurement:
        measurement = self.arm.measure()
        self._check_first(self.arm, "measure", measurement)
        return measurement

    def _check_first(self, device: object, method: str, value: object) -> None:
        """Check the first value that a method returns; later ones are not checked."""
        if method in self._unchecked:
            check_first_value(device, method, value)
            self._unchecked.remove(method)

    def _track(self, frame: Frame) -> None:
        """Track the markers in a new frame, or store the reason for dropping it."""
        self._drop_reason = self._find_defect(frame)
        if self._drop_reason is not DropReason.NONE or frame.exposure < self._valid_from:
            return
        try:
            markers = self.tracker.find(frame)
        except BadInput:
            self._drop_reason = DropReason.DAMAGED
            return
        self._check_first(self.tracker, "find", markers)
        self.image_shape = get_image_shape(frame)
        if self.frame is None:
            self._frame_number = max(frame.number, 0)
        else:
            self._frame_number += count_frames_since(self.frame, frame)
        self.markers, self.frame = replace(markers, points=_select_possible(markers)), frame
        self._sizes, self._quality = _measure_sizes(self.markers), _measure_quality(self.markers)
        is_known = frame.exposure >= self._joints.oldest
        self._q_exposure = (
            self._joints.interpolate(frame.exposure) if is_known else np.full(3, np.nan)
        )

    def _find_defect(self, frame: Frame) -> DropReason:
        """Return the reason for not using a frame; NONE if it is usable."""
        if (
            not 0 <= frame.arrival - frame.exposure <= MAX_FRAME_AGE_NS
            or not 0 <= self.clock.now() - frame.arrival <= MAX_FRAME_AGE_NS
        ):
            return DropReason.CLOCK
        previous = self.frame
        if previous is None:
            return DropReason.NONE
        if not count_frames_since(previous, frame) > 0:
            return DropReason.NOT_NEW
        if not frame.exposure > previous.exposure:
            return DropReason.CLOCK
        same_shape = get_image_shape(frame) == get_image_shape(previous)
        return DropReason.NONE if same_shape else DropReason.DAMAGED


def count_frames_since(previous: Frame, frame: Frame) -> int:
    """Return by how many frames the camera has advanced; not above 0 if the frame is not new.

    The frame number of some cameras starts again at zero after 16, 31 or 32 bits.
    """
    advance = frame.number - previous.number
    if advance <= 0:
        for count in FRAME_COUNTERS:
            if 0 < advance + count < count // 2:
                return advance + count
    return advance


def _select_possible(markers: Markers) -> Floats:
    """Return the raw markers (2, 2) in px, NaN for one outside any possible image.

    Estimators would use every finite number.
    """
    is_possible = (np.abs(markers.points) < MAX_PIXEL_COORDINATE).all(axis=1, keepdims=True)
    return np.where(is_possible, markers.points, np.nan)


def _measure_sizes(markers: Markers) -> Floats:
    """Return the apparent radii (2,) in px, NaN for a lost marker."""
    is_detected = np.isfinite(markers.points).all(axis=1)
    return np.where(is_detected, markers.radius, np.nan)


def _measure_quality(markers: Markers) -> Floats:
    """Return the detection quality (2,), 0 for a lost marker; NaN if the tracker reports none."""
    is_detected = np.isfinite(markers.points).all(axis=1)
    quality = np.asarray(markers.quality, dtype=np.float64)
    return np.where(is_detected, quality, 0.0) if quality.shape == (2,) else np.full(2, np.nan)


def get_image_shape(frame: Frame) -> tuple[int, ...] | None:
    """Return the shape of a frame's image; None without one."""
    return None if frame.image is None else frame.image.shape
