"""The simulated arm and camera, running in processes of their own: a client of the live wing.

bench ─┬─► arm process      physics and watchdog, in wall time     ▲ wire: commands, answers
       ├─► camera process   renders into shared memory             │
       └─  session ───────► servo process ─────────────────────────┘
"""

import contextlib
import tempfile
from collections.abc import Callable
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rcmservo.errors import UnusableFile
from rcmservo.live.arm_link import RemoteArm, teach_and_return
from rcmservo.live.child import END, Child
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.servo_process import Session
from rcmservo.loop.shown import TEACHING_FRAMES
from rcmservo.record.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.sim.processes.arm_process import emulate
from rcmservo.sim.processes.camera_process import film
from rcmservo.sim.processes.live_disturbances import Mischief
from rcmservo.sim.processes.motion_log import MotionLog, TrueError, stopped
from rcmservo.sim.rig import RigSettings
from rcmservo.tracking import ColourMarkers, MarkerLook

LONGEST = 80
"""Bytes of a folder's path that leave room for the sockets in it."""


class Bench:
    """A simulated arm and its camera that run; use it as a context."""

    def __init__(self, seed: int, settings: RigSettings) -> None:
        context = get_context("spawn")
        self.settings = settings
        self.log = MotionLog(context)
        self.ring = FrameRing(context, settings.width, settings.height)
        self._context, self._seed = context, seed
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> "Bench":
        with self._stack:
            folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="rcmservo-"))
            self.folder = _short(Path(folder))
            self.arm = self._child(emulate, self.folder, self._seed, self.settings, self.log)
            self.target: Any = self.arm.hear()
            self.camera = self._child(film, self._seed, self.settings, self.log, self.ring)
            self.camera.hear()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _child(self, work: Callable[..., None], *arguments: Any) -> Child:
        child = Child(self._context, work, *arguments)
        self._stack.callback(child.end)
        return child

    def session(
        self,
        servo: Servo,
        markers: MarkerLook,
        duration: float,
        record: Path,
        about: dict[str, Any] | None = None,
        frames: int = TEACHING_FRAMES,
    ) -> Session:
        """A live run of `duration` s on this bench, recorded in a new file with what it says of the
        run. Its target is the mean of so many frames."""
        return Session(
            servo,
            duration,
            arm=partial(RemoteArm, self.folder),
            camera=partial(RingCamera, self.ring),
            tracker=partial(ColourMarkers, markers),
            recorder=partial(Recorder, record, about or {}),
            target=partial(teach_and_return, frames=frames),
        )

    def off(self, began: bool) -> str:
        """Have the drive switched off, and say in words how the arm stands."""
        self.arm.tell("off")
        if self.arm.wire.poll(END):
            self.arm.hear()
        rows = self.log.since(0)
        stop = stopped(rows)
        if stop is None:
            return "the arm does not say that its drive is off: use its emergency stop"
        after = (rows["time"][stop[1]] - rows["time"][stop[0]]) * 1e-6
        took = f"the arm's drive went off {after:.0f} ms after its last command"
        return took if began else "the arm's drive is off"

    def befall(self, trouble: Mischief) -> None:
        """Let trouble begin, or end, in the arm and before the camera."""
        for device in (self.arm, self.camera):
            device.tell(trouble)

    def error(self) -> float:
        """‖p₂ − p_d‖ mm, by the truth: how far the tool is from where it was shown."""
        return TrueError(self.settings, self.log)(self.settings.drive.told(self.target))


def _short(folder: Path) -> Path:
    """A folder whose path leaves room for sockets."""
    if len(str(folder).encode()) > LONGEST:
        why = f"must be at most {LONGEST} bytes long for sockets: set a shorter TMPDIR"
        raise UnusableFile(folder, why)
    return folder
