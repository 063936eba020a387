"""Camera read by a separate thread: the common part of all camera drivers.

The newest frame is available at once, and a lost camera is reopened. Frame numbers rise for as long
as the camera is in use, even after it was reopened.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Frame, Image
from rcmservo.loop.run_result import CameraStatistics, finite_or_none

REOPEN_PERIOD_S = 1.0
"""Period of the attempts to reopen a lost camera."""
MAX_SILENCE_S = 1.0
"""Time without a complete frame after which the camera has a problem."""
CLOSE_TIMEOUT_S = 10.0
"""Time for the reading thread to return from the camera."""


class CameraLost(RcmServoError):
    """Error of a camera that cannot be opened or has disappeared."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Result of one exposure.

    Parameters
    ----------
    image : Image or None
        Blue-green-red image (height, width, 3); None if the frame is incomplete.
    exposure : int
        Middle of the exposure, ns on the computer's clock.
    arrival : int
        Arrival at the computer, ns.
    lost : int
        Number of frames just before this one that never arrived.
    skipped : int
        Number of complete frames just before this one, skipped for it.
    incomplete : int
        Number of incomplete frames just before this one.
    uncertainty : float
        Uncertainty of the exposure time in s; NaN without time stamps, or with those of another
        computer's clock.
    """

    image: Image | None
    exposure: int
    arrival: int
    lost: int = 0
    skipped: int = 0
    incomplete: int = 0
    uncertainty: float = float("nan")


class CameraStream(Protocol):
    """Open connection to a camera."""

    def read(self) -> Snapshot | None:
        """Wait for a frame, a fraction of a second at most; return None if there is none.

        Raises
        ------
        CameraLost
            If no more frames will come.
        """
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


class StreamedCamera:
    """Camera with a reading thread. The newest frame replaces older ones.

    The constructor opens the camera, so errors appear at once.

    Parameters
    ----------
    open_stream : callable
        Function that opens the camera.
    reopens : bool
        True if a lost camera is opened again.
    reopen_period : float
        Period of the attempts in s.
    """

    def __init__(
        self,
        open_stream: Callable[[], CameraStream],
        reopens: bool = True,
        reopen_period: float = REOPEN_PERIOD_S,
    ) -> None:
        self._open_stream, self._reopens, self._reopen_period = open_stream, reopens, reopen_period
        self._frame: Frame | None = None
        self._number, self._last_frame_time = -1, time.monotonic()
        self._incomplete_in_a_row = 0
        self._statistics = CameraStatistics()
        self._error: Exception | None = None
        self._closing = threading.Event()
        self._stream: CameraStream | None = open_stream()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def latest(self) -> Frame | None:
        """Return the newest frame at once, None before the first one."""
        if self._error is not None:
            raise self._error
        return self._frame

    def counts(self) -> CameraStatistics:
        """Return counts of the frames so far, and the camera's present problem."""
        silence = time.monotonic() - self._last_frame_time
        if self._statistics.trouble or silence <= MAX_SILENCE_S:
            return self._statistics
        count = self._incomplete_in_a_row
        cause = f": {count} came incomplete" if count else ""
        problem = f"no complete frame has come for {silence:.0f} s{cause}"
        return replace(self._statistics, trouble=problem)

    def close(self) -> None:
        """Close the camera."""
        self._closing.set()
        self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._read_or_reopen()
        except Exception as error:
            self._error = error
        finally:
            self._close_stream()

    def _read_or_reopen(self) -> None:
        if self._stream is None:
            self._reopen()
            return
        try:
            snapshot = self._stream.read()
        except CameraLost as error:
            self._update_statistics(trouble=str(error))
            self._close_stream()
            return
        if snapshot is not None:
            self._accept(snapshot)

    def _reopen(self) -> None:
        pause = self._reopen_period if self._reopens else MAX_SILENCE_S
        if self._closing.wait(pause) or not self._reopens:
            return
        try:
            self._stream = self._open_stream()
        except RcmServoError as error:
            self._update_statistics(trouble=str(error))
        else:
            self._update_statistics(reconnects=self._statistics.reconnects + 1, trouble="")

    def _accept(self, snapshot: Snapshot) -> None:
        """Make the image the newest frame and count it. An image of another size is dropped."""
        self._number += 1 + snapshot.lost + snapshot.skipped + snapshot.incomplete
        image, problem = snapshot.image, ""
        previous_image = None if self._frame is None else self._frame.image
        if image is not None and previous_image is not None and image.shape != previous_image.shape:
            image, problem = None, "images have another size than before"
        statistics, uncertainty_ms = self._statistics, self._statistics.uncertainty_ms
        incomplete = snapshot.incomplete + (image is None)
        self._incomplete_in_a_row += incomplete
        if image is not None:
            self._last_frame_time, self._incomplete_in_a_row = time.monotonic(), 0
            self._frame = Frame(self._number, snapshot.exposure, snapshot.arrival, image=image)
            uncertainty_ms = finite_or_none(1e3 * snapshot.uncertainty)
        self._update_statistics(
            frames=statistics.frames + snapshot.skipped + (image is not None),
            lost=statistics.lost + snapshot.lost,
            incomplete=statistics.incomplete + incomplete,
            uncertainty_ms=uncertainty_ms,
            trouble=problem,
        )

    def _update_statistics(self, **changes: float | str | None) -> None:
        values: Any = changes
        self._statistics = replace(self._statistics, **values)

    def _close_stream(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
