"""Simulated arm and camera in separate processes: a client of the live package.

parent ─┬─► arm process      physics and watchdog, in wall time     ▲ socket: commands, states
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
from rcmservo.live.arm_datagrams import RemoteArm, teach_and_return
from rcmservo.live.child_process import END, Child
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.servo_process import Session
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo
from rcmservo.sim.processes.arm_process import run_arm_process
from rcmservo.sim.processes.camera_process import film
from rcmservo.sim.processes.live_disturbances import Mischief
from rcmservo.sim.processes.motion_log import MotionLog, TrueError, stopped
from rcmservo.sim.rig import RigSettings
from rcmservo.tracking import ColourMarkers, MarkerLook

MAX_FOLDER_BYTES = 80
"""Length (bytes) of a folder's path that leaves room for the sockets' names."""


class Bench:
    """Simulated arm and camera in separate processes; use it as a context manager.

    Parameters
    ----------
    seed : int
        Seed of the laboratory.
    settings : RigSettings
        Parts of the laboratory.

    Raises
    ------
    RcmServoError
        On entry, if the laboratory cannot be built or its folder's path is too long for sockets.
    """

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
            self.folder = _require_short(Path(folder))
            self.arm = self._start_child(
                run_arm_process, self.folder, self._seed, self.settings, self.log
            )
            self.target: Any = self.arm.hear()
            self.camera = self._start_child(film, self._seed, self.settings, self.log, self.ring)
            self.camera.hear()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _start_child(self, work: Callable[..., None], *arguments: Any) -> Child:
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
        """Return a live session on this laboratory.

        Parameters
        ----------
        servo : Servo
            Servo that runs.
        markers : MarkerLook
            Appearance of the markers.
        duration : float
            Length of the session, s.
        record : pathlib.Path
            File of the record, which must not exist.
        about : dict, optional
            Description of the run in the record.
        frames : int
            Frames of the taught target.
        """
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
        """Switch the drive off and return the arm's state in words.

        Parameters
        ----------
        began : bool
            True if the session has sent commands.
        """
        self.arm.tell("off")
        if self.arm.wire.poll(END):
            self.arm.hear()
        rows = self.log.since(0)
        stop = stopped(rows)
        if stop is None:
            return "the arm did not report that its drive is off: use its emergency stop"
        after = (rows["time"][stop[1]] - rows["time"][stop[0]]) * 1e-6
        words = f"the arm's drive went off {after:.0f} ms after its last command"
        return words if began else "the arm's drive is off"

    def befall(self, change: Mischief) -> None:
        """Start or end a disturbance in the arm and the camera."""
        for device in (self.arm, self.camera):
            device.tell(change)

    def error(self) -> float:
        """Return ‖p₂ − p_d‖ (mm), the true distance of the tool from the taught target."""
        return TrueError(self.settings, self.log)(self.settings.drive.told(self.target))


def _require_short(folder: Path) -> Path:
    """Return the folder if its path leaves room for sockets, raise `UnusableFile` otherwise."""
    if len(str(folder).encode()) > MAX_FOLDER_BYTES:
        reason = f"must be at most {MAX_FOLDER_BYTES} bytes long for sockets: set a shorter TMPDIR"
        raise UnusableFile(folder, reason)
    return folder
