"""Detection beside the loop: a thread tracks the markers in each new frame, and the loop takes what
is ready.

A tick never waits for a picture. The thread is camera and tracker in one for the plant: a frame is
offered once its markers are found, and counts as arrived at that moment.
"""

import threading
from dataclasses import replace
from types import TracebackType

from rcmservo.errors import BadInput
from rcmservo.interfaces import Camera, Clock, Explains, Frame, Markers, Tracker
from rcmservo.loop.clock import ticks
from rcmservo.loop.first_answer import look_at

POLL = 0.001
"""s between looks at the camera."""

PATIENCE = 2.0
"""s that a thread has to end in."""


class TrackingThread:
    """A camera and a tracker that work in a thread of their own while the context is open.

    A frame that the tracker refuses is offered as it is and refused again by `find`. If camera or
    tracker fail before the first frame is offered, `latest` raises the error. If they fail later,
    no more frames are offered, so that the servo stops in order, and the error is raised where the
    context ends.
    """

    def __init__(self, camera: Camera, tracker: Tracker, clock: Clock) -> None:
        self._camera, self._tracker, self._clock = camera, tracker, clock
        self._newest: Frame | None = None
        self._offered: tuple[Frame, Markers | BadInput] | None = None
        self._taken: tuple[Frame, Markers | BadInput] | None = None
        self._forget = threading.Event()
        self._ended = threading.Event()
        self._at_work, self._tracked = False, 0
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="markers", daemon=True)

    def __enter__(self) -> "TrackingThread":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join(PATIENCE)
        if self._error is not None and error is None:
            raise self._error

    def latest(self) -> Frame | None:
        """The newest frame whose markers have been looked for, at once."""
        self._taken = self._offered
        if self._taken is None and self._error is not None:
            raise self._error
        return None if self._taken is None else self._taken[0]

    def find(self, frame: Frame) -> Markers:
        """The markers found in the frame that `latest` gave last."""
        assert self._taken is not None and frame is self._taken[0]
        found = self._taken[1]
        if isinstance(found, BadInput):
            raise found
        return found

    def why(self, frame: Frame) -> str:
        """What the tracker says of a frame, if it can tell why it did not find the markers."""
        return self._tracker.why(frame) if isinstance(self._tracker, Explains) else ""

    def reset(self) -> None:
        """Forget where the markers were, before the next frame."""
        self._forget.set()

    def wait_for(self, frames: int, patience: float) -> None:
        """Return when so many frames have been tracked, however long the tracker takes, as it is
        compiled for the first ones; or when the camera has given none for ``patience`` s."""
        tracked, since = 0, self._clock.now()
        for _ in ticks(self._clock, 1.0 / POLL):
            if self._at_work or self._tracked > tracked:
                tracked, since = self._tracked, self._clock.now()
            silent = not self._clock.now() - since <= patience * 1e9
            if tracked >= frames or silent or not self._thread.is_alive():
                return

    def look(self) -> None:
        """Track the markers in the camera's newest frame, if it is new: what the thread does all
        the time."""
        frame = self._camera.latest()
        if frame is None or frame is self._newest:
            return
        look_at(self._camera, "latest", frame)
        self._newest, self._at_work = frame, True
        if self._forget.is_set():
            self._forget.clear()
            self._tracker.reset()
        found = self._found(frame)
        self._offered = replace(frame, arrival=self._clock.now()), found
        self._tracked += 1
        self._at_work = False

    def _found(self, frame: Frame) -> Markers | BadInput:
        """The markers in a frame, or why it is refused."""
        try:
            found = self._tracker.find(frame)
        except BadInput as error:
            return error
        look_at(self._tracker, "find", found)
        return found

    def _work(self) -> None:
        try:
            while not self._ended.wait(POLL):
                self.look()
        except Exception as error:
            self._error = error
