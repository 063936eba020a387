"""Marker detection in a thread next to the loop, so that the loop never waits for an image.

To the plant the thread is camera and tracker in one: it offers a frame once its markers are
detected, and the frame counts as arrived at that moment.
"""

import threading
from dataclasses import replace
from typing import Self

from rcmservo.errors import BadInput
from rcmservo.interfaces import Camera, Clock, FailureExplainer, Frame, Markers, Tracker
from rcmservo.loop.clock import ticks
from rcmservo.loop.device_checks import check_first_value

POLL_S = 0.001
"""Interval in s at which the thread polls the camera."""

EXIT_TIMEOUT_S = 2.0
"""Time in s within which the thread must end."""


class TrackingThread:
    """Camera and tracker that run in a thread while the context is open.

    A frame that the tracker refuses is offered unchanged, and `find` refuses it again. If camera or
    tracker fail before the first frame is offered, `latest` raises the error. If they fail later,
    no more frames are offered, so the servo stops in order, and the error is raised at the end of
    the context.

    Parameters
    ----------
    camera : Camera
        Source of the frames.
    tracker : Tracker
        Detector of the markers.
    clock : Clock
        Clock of the plant.
    """

    def __init__(self, camera: Camera, tracker: Tracker, clock: Clock) -> None:
        self._camera, self._tracker, self._clock = camera, tracker, clock
        self._newest: Frame | None = None
        self._offered: tuple[Frame, Markers | BadInput] | None = None
        self._latest: tuple[Frame, Markers | BadInput] | None = None
        self._reset_requested = threading.Event()
        self._stop_requested = threading.Event()
        self._is_tracking, self._tracked_count = False, 0
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._track_frames, name="markers", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._stop_requested.set()
        self._thread.join(EXIT_TIMEOUT_S)
        if self._error is not None and error is None:
            raise self._error

    def latest(self) -> Frame | None:
        """Return the newest frame that the tracker has processed, without waiting."""
        self._latest = self._offered
        if self._latest is None and self._error is not None:
            raise self._error
        return None if self._latest is None else self._latest[0]

    def find(self, frame: Frame) -> Markers:
        """Return the markers in the frame that `latest` returned last.

        Raises
        ------
        BadInput
            If the tracker refuses the frame.
        """
        assert self._latest is not None and frame is self._latest[0]
        markers = self._latest[1]
        if isinstance(markers, BadInput):
            raise markers
        return markers

    def explain_failure(self, frame: Frame) -> str:
        """Return the tracker's reason for not detecting the markers, or an empty string."""
        tracker = self._tracker
        return tracker.explain_failure(frame) if isinstance(tracker, FailureExplainer) else ""

    def reset(self) -> None:
        """Reset the tracker before the next frame."""
        self._reset_requested.set()

    def wait_for(self, frames: int, timeout_s: float) -> None:
        """Wait until a number of frames are tracked, or until the camera is silent.

        The camera counts as silent if it delivers no frame for ``timeout_s`` s. The time that the
        tracker takes for a frame does not count, because it compiles its kernels for the first one.
        """
        tracked, active_ns = 0, self._clock.now()
        for _ in ticks(self._clock, 1.0 / POLL_S):
            if self._is_tracking or self._tracked_count > tracked:
                tracked, active_ns = self._tracked_count, self._clock.now()
            is_silent = not self._clock.now() - active_ns <= timeout_s * 1e9
            if tracked >= frames or is_silent or not self._thread.is_alive():
                return

    def track_newest_frame(self) -> None:
        """Track the markers in the camera's newest frame, if it is new."""
        frame = self._camera.latest()
        if frame is None or frame is self._newest:
            return
        check_first_value(self._camera, "latest", frame)
        self._newest, self._is_tracking = frame, True
        if self._reset_requested.is_set():
            self._reset_requested.clear()
            self._tracker.reset()
        markers = self._find_markers(frame)
        self._offered = replace(frame, arrival=self._clock.now()), markers
        self._tracked_count += 1
        self._is_tracking = False

    def _find_markers(self, frame: Frame) -> Markers | BadInput:
        """Return the markers in a frame, or the reason for refusing it."""
        try:
            markers = self._tracker.find(frame)
        except BadInput as error:
            return error
        check_first_value(self._tracker, "find", markers)
        return markers

    def _track_frames(self) -> None:
        try:
            while not self._stop_requested.wait(POLL_S):
                self.track_newest_frame()
        except Exception as error:
            self._error = error
