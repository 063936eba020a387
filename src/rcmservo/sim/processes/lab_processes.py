"""Simulated laboratory in wall time: arm and camera in separate processes, as real devices are.

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
from rcmservo.interfaces import Tracker
from rcmservo.live.arm_datagrams import RemoteArm, teach_and_return
from rcmservo.live.child_process import EXIT_TIMEOUT_S, ChildProcess
from rcmservo.live.frame_ring import FrameRing, RingCamera
from rcmservo.live.servo_process import Session
from rcmservo.loop.target_frames import TEACHING_FRAMES
from rcmservo.recording.writer import Recorder
from rcmservo.rig.lazy_rig import LazyRig
from rcmservo.servo.servo import Servo
from rcmservo.sim.processes.arm_process import run_arm_process
from rcmservo.sim.processes.camera_process import run_camera_process
from rcmservo.sim.processes.live_disturbances import DisturbanceChange
from rcmservo.sim.processes.motion_log import MotionLog, TruePositionError, find_stop
from rcmservo.sim.rig import RigSettings

MAX_FOLDER_BYTES = 80
"""Length (bytes) of a folder's path that leaves room for the sockets' names."""


class SimulatedLab:
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

    target: Any
    """True joints (3,) of the target, once the laboratory runs."""

    def __init__(self, seed: int, settings: RigSettings) -> None:
        context = get_context("spawn")
        self.settings = settings
        self.log = MotionLog(context)
        self.ring = FrameRing(context, settings.width, settings.height)
        self._context, self._seed = context, seed
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> "SimulatedLab":
        with self._stack:
            folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="rcmservo-"))
            self.folder = _require_short(Path(folder))
            arguments = self._seed, self.settings, self.log
            self.arm = self._start_child(run_arm_process, self.folder, *arguments)
            self.camera = self._start_child(run_camera_process, *arguments, self.ring)
            self.target = self.arm.receive()
            self.camera.receive()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _start_child(self, function: Callable[..., None], *arguments: Any) -> ChildProcess:
        """Start a process that calls a function and that ends with the laboratory."""
        child = ChildProcess(self._context, function, *arguments)
        self._stack.callback(child.end)
        return child

    def session(
        self,
        servo: Servo,
        tracker: Callable[[], Tracker],
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
        tracker : Callable[[], Tracker]
            Function that makes the marker tracker in the servo process.
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
            LazyRig(
                partial(RemoteArm, self.folder),
                partial(RingCamera, self.ring),
                tracker,
                self.settings.mechanism,
                self.settings.tool,
            ),
            recorder=partial(Recorder, record, about or {}),
            target=partial(teach_and_return, frames=frames),
        )

    def switch_off(self, began: bool) -> str:
        """Switch the drive off and return the arm's state in words.

        Parameters
        ----------
        began : bool
            True if the session has sent commands.
        """
        self.arm.send("off")
        if self.arm.pipe.poll(EXIT_TIMEOUT_S):
            self.arm.receive()
        rows = self.log.since(0)
        stop = find_stop(rows)
        if stop is None:
            return "the arm did not report that its drive is off: use its emergency stop"
        if not began:
            return "the arm's drive is off"
        command_time, off_time = rows["time"][list(stop)]
        delay_ms = (off_time - command_time) * 1e-6
        return f"the arm's drive went off {delay_ms:.0f} ms after its last command"

    def disturb(self, change: DisturbanceChange) -> None:
        """Start or end a disturbance in the arm and the camera."""
        for process in (self.arm, self.camera):
            process.send(change)

    def true_error(self) -> float:
        """Return ‖p₂ − p_d‖ (mm), the true distance of the tool from the taught target."""
        true_error = TruePositionError(self.settings, self._seed, self.log)
        return true_error(self.settings.drive.measured(self.target))


def _require_short(folder: Path) -> Path:
    """Return the folder if its path leaves room for sockets, raise `UnusableFile` otherwise."""
    if len(str(folder).encode()) > MAX_FOLDER_BYTES:
        reason = f"must be at most {MAX_FOLDER_BYTES} bytes long for sockets: set a shorter TMPDIR"
        raise UnusableFile(folder, reason)
    return folder
