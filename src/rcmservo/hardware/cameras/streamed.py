"""What the drivers of cameras share: a thread that reads frame after frame, so that nobody who asks
for the newest one waits, and that opens a lost camera again.

Frame numbers rise for as long as the camera is in use, also where it was opened again.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Frame, Image
from rcmservo.loop.run_result import CameraAccount, known

AGAIN = 1.0
"""s between two attempts to open a camera that was lost."""
SILENT = 1.0
"""s without a whole frame after which that is a trouble."""
PATIENCE = 10.0
"""s in which a driver comes back from the camera, whatever it waits for."""


class CameraLost(RcmServoError):
    """A camera that cannot be opened, or that is there no more."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What came of one exposure."""

    image: Image | None
    """Blue-green-red; None where it came incomplete."""
    exposure: int
    """ns, its middle on the computer's clock."""
    arrival: int
    """ns, when the computer had it."""
    missed: int = 0
    """Those before it that never came."""
    passed: int = 0
    """Those before it that came, and were passed over for it."""
    spoilt: int = 0
    """Those before it that came incomplete."""
    uncertainty: float = float("nan")
    """s, how well the exposure is known; NaN where the camera tells no times, or those of another
    computer's clock."""


class CameraStream(Protocol):
    """A camera while it is open."""

    def next(self) -> Snapshot | None:
        """Wait for a frame, a part of a second at most: None if none has come. :class:`CameraLost`
        where none will come any more."""
        ...

    def close(self) -> None:
        """Let it go."""
        ...


class StreamedCamera:
    """A camera that a thread reads from: newest frame wins. It is opened at once, so that what is
    wrong is told at once; ``lasting`` is one that is worth opening again where it is lost."""

    def __init__(
        self, opened: Callable[[], CameraStream], lasting: bool = True, again: float = AGAIN
    ) -> None:
        self._opened, self._lasting, self._again = opened, lasting, again
        self._frame: Frame | None = None
        self._number, self._heard, self._torn = -1, time.monotonic(), 0
        self._account = CameraAccount()
        self._error: Exception | None = None
        self._over = threading.Event()
        self._stream: CameraStream | None = opened()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def latest(self) -> Frame | None:
        """The newest frame, at once."""
        if self._error is not None:
            raise self._error
        return self._frame

    def account(self) -> CameraAccount:
        """What became of its frames so far."""
        silent = time.monotonic() - self._heard
        if self._account.trouble or silent <= SILENT:
            return self._account
        torn = f": {self._torn} came incomplete" if self._torn else ""
        trouble = f"no whole frame has come for {silent:.0f} s{torn}"
        return replace(self._account, trouble=trouble)

    def close(self) -> None:
        """Let the camera go."""
        self._over.set()
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        try:
            while not self._over.is_set():
                self._turn()
        except Exception as error:
            self._error = error
        finally:
            self._let_go()

    def _turn(self) -> None:
        if self._stream is None:
            self._open_again()
            return
        try:
            shot = self._stream.next()
        except CameraLost as error:
            self._note(trouble=str(error))
            self._let_go()
            return
        if shot is not None:
            self._take(shot)

    def _open_again(self) -> None:
        if self._over.wait(self._again if self._lasting else SILENT) or not self._lasting:
            return
        try:
            self._stream = self._opened()
        except RcmServoError as error:
            self._note(trouble=str(error))
        else:
            self._note(reconnects=self._account.reconnects + 1, trouble="")

    def _take(self, shot: Snapshot) -> None:
        """Make a picture the newest frame, and keep account of it."""
        then, account = self._frame, self._account
        self._number += 1 + shot.missed + shot.passed + shot.spoilt
        image, trouble = shot.image, ""
        last = None if then is None else then.image
        if image is not None and last is not None and image.shape != last.shape:
            image, trouble = None, "pictures come of another size than before"
        self._torn += shot.spoilt + (image is None)
        if image is not None:
            self._heard, self._torn = time.monotonic(), 0
            self._frame = Frame(self._number, shot.exposure, shot.arrival, image=image)
        self._note(
            frames=account.frames + shot.passed + (image is not None),
            lost=account.lost + shot.missed,
            incomplete=account.incomplete + shot.spoilt + (image is None),
            uncertainty_ms=account.uncertainty_ms
            if image is None
            else known(1e3 * shot.uncertainty),
            trouble=trouble,
        )

    def _note(self, **changes: float | str | None) -> None:
        self._account = replace(self._account, **changes)  # pyright: ignore[reportArgumentType]

    def _let_go(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
