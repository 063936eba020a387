"""A live run on the simulated arm: the arm, its camera and the servo in processes of their own, and
one that watches.

    supervisor ─┬─► arm       physics and watchdog, in wall time       ▲ wire: commands, answers
                ├─► camera    renders into shared memory               │
                └─► servo     tracks, decides, commands ───────────────┘

The arm stops by itself when commands stop. The supervisor is the one who notices why: a servo
process that is gone or does not tick any more. It has the drive switched off, ends the servo for
good, so that nobody can wake it up to move the arm, and says what happened. When the supervisor
itself is gone, the others end by themselves.
"""

import contextlib
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from pathlib import Path
from typing import Any, cast

import numpy as np

from rcmservo.errors import RcmServoError, UnusableFile
from rcmservo.live.frame_ring import FrameRing
from rcmservo.live.servo_process import STANDING, Report, Task, serve
from rcmservo.sim.body import Body
from rcmservo.sim.processes.device import emulate
from rcmservo.sim.processes.filming import film
from rcmservo.sim.processes.log import Log, stopped
from rcmservo.sim.rig import RigSettings

LOOK = 10_000_000
"""ns between looks at the servo's heartbeat."""

SILENT = 10
"""Looks in a row at which the heartbeat stood still: then the servo process is stopped. Counting
looks, not time, makes no difference between the servo and the watching process when the whole
computer stalls."""

END = 3.0
"""s within which a process ends that is told to."""


DYING = 0.5
"""s that a process which is killed needs at most to be gone; one that is not is only stopped."""


LONGEST = 80
"""Bytes of a folder's path that leave room for the sockets in it."""


class Child:
    """A process that this one started, and the wire to it. It ends when it is told to, and is
    killed if it does not."""

    def __init__(self, context: SpawnContext, work: Callable[..., None], *arguments: Any) -> None:
        self.wire, its = context.Pipe()
        self.process = context.Process(target=work, args=(*arguments, its), daemon=True)
        with _ctrl_c_left_to_us():
            self.process.start()
        its.close()

    def hear(self) -> Any:
        """The next thing it says; what it could not do is raised."""
        try:
            said = self.wire.recv()
        except (EOFError, OSError) as error:
            self.process.join(END)
            raise RcmServoError(
                f"a process of the simulation ended by itself: {self.process.name}"
            ) from error
        if isinstance(said, RcmServoError):
            raise said
        return said

    def tell(self, word: str) -> None:
        with contextlib.suppress(OSError):
            self.wire.send(word)

    def end(self) -> None:
        """Tell it to end, or kill it."""
        self.tell("end")
        self.process.join(END)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.wire.close()


@contextlib.contextmanager
def _ctrl_c_left_to_us() -> Generator[None]:
    """Processes started in here do not end by Ctrl-C: they are ended in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


class Bench:
    """The simulated arm and its camera, running; use it as a context. A servo is started on it with
    `servo`."""

    def __init__(self, seed: int, settings: RigSettings) -> None:
        self.context = get_context("spawn")
        self.settings = settings
        self.log, self.ring = (
            Log(self.context),
            FrameRing(self.context, settings.width, settings.height),
        )
        self.beats: Any = self.context.RawValue("q", STANDING)
        self._stack = contextlib.ExitStack()
        self._seed = seed

    def __enter__(self) -> "Bench":
        with self._stack:
            self.folder = Path(
                self._stack.enter_context(tempfile.TemporaryDirectory(prefix="rcmservo-"))
            )
            if len(str(self.folder).encode()) > LONGEST:
                raise UnusableFile(
                    self.folder,
                    f"must be at most {LONGEST} bytes long for sockets: set a shorter TMPDIR",
                )
            self.arm = self._child(emulate, self.folder, self._seed, self.settings, self.log)
            self.target: Any = self.arm.hear()
            self.camera = self._child(film, self._seed, self.settings, self.log, self.ring)
            self.camera.hear()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _child(self, work: Callable[..., None], *arguments: Any) -> Child:
        child = Child(self.context, work, *arguments)
        self._stack.callback(child.end)
        return child

    def servo(self, task: Task) -> Child:
        """A process that servos on this bench."""
        self.beats.value = STANDING
        return Child(self.context, serve, self.folder, self.ring, self.beats, task)

    def off(self) -> None:
        """Have the drive switched off; once this returns, it is."""
        self.arm.tell("off")
        if self.arm.wire.poll(END):
            self.arm.hear()

    def error(self) -> float:
        """‖p₂ − p_d‖ mm, by the truth: how far the tool is from where it was shown."""
        body = Body(self.settings.mechanism, self.settings.tool)
        return float(
            np.linalg.norm(body.points(self.log.last()["q"])[1] - body.points(self.target)[1])
        )


class Watchman:
    """Watches a servo process: whether it is gone, and whether its heart beats while its loop
    runs."""

    def __init__(self, servo: Child, beats: Any) -> None:
        self._servo, self._beats = servo, beats
        self._last, self._still, self._due = STANDING, 0, 0

    def look(self) -> bool:
        """Whether something is wrong with the process; it looks at most once in LOOK."""
        now = time.monotonic_ns()
        if now < self._due:
            return False
        self._due = now + LOOK
        beat = self._beats.value
        self._still = self._still + 1 if beat == self._last and beat != STANDING else 0
        self._last = beat
        return self._still >= SILENT or self._servo.process.exitcode is not None


def run_live(
    seed: int,
    settings: RigSettings,
    task: Task,
    progress: Callable[[Report], None] = lambda report: None,
) -> dict[str, Any]:
    """Run the task on a simulated arm in wall time; the measures of the run, as plain numbers.

    Ctrl-C lets the servo bring the arm to rest and end its record, and is then raised as usual.
    """
    with Bench(seed, settings) as bench:
        servo = bench.servo(task)
        try:
            result = supervise(bench, servo, progress)
        except KeyboardInterrupt:
            servo.tell("end")
            with contextlib.suppress(RcmServoError):
                supervise(bench, servo, progress)
            raise
        finally:
            servo.end()
        return result | {"pose_error_mm": bench.error()}


def supervise(bench: Bench, servo: Child, progress: Callable[[Report], None]) -> dict[str, Any]:
    """Watch over a servo process until it has told how its run went, or cannot any more."""
    watchman, began = Watchman(servo, bench.beats), 0
    ears = [servo.wire]
    while True:
        for wire in cast(list[Connection], wait(ears, LOOK * 1e-9) if ears else []):
            said = _next(wire)
            if isinstance(said, Report):
                progress(said)
            elif said is not None:
                return _result(said)
            else:
                ears.clear()
                servo.process.join(END)
        if not began and bench.beats.value != STANDING:
            began = time.monotonic_ns()
        if watchman.look():
            return _fallen(bench, servo, began)


def _next(wire: Connection) -> Any:
    """What the servo process says next; None where it can say nothing more."""
    try:
        return wire.recv()
    except (EOFError, OSError):
        return None


def _result(said: Any) -> dict[str, Any]:
    if isinstance(said, RcmServoError):
        raise said
    if isinstance(said, str):
        raise RuntimeError(f"the servo process failed:\n{said}")
    return cast(dict[str, Any], said)


def _fallen(bench: Bench, servo: Child, began: int) -> dict[str, Any]:
    """Make sure that the arm stands still and stays so, and say what happened."""
    now = time.monotonic_ns()
    bench.off()
    servo.process.join(DYING)
    code = servo.process.exitcode
    wrong = "was stopped: it did not tick any more"
    if code is not None:
        wrong = (
            f"was killed ({signal.Signals(-code).name})"
            if code < 0
            else f"ended by itself (exit code {code})"
        )
    servo.process.kill()
    servo.process.join()
    rows = bench.log.since(0)
    stop = stopped(rows)
    when = f"{(now - began) * 1e-9:.1f} s into the run" if began else "before the arm was enabled"
    stands = "the arm does not say that its drive is off: use its emergency stop"
    if stop is not None:
        after = (rows["time"][stop[1]] - rows["time"][stop[0]]) * 1e-6
        stands = (
            f"the arm's drive went off {after:.0f} ms after its last command"
            if began
            else "the arm's drive is off"
        )
    return {"settled": False, "cause": f"the servo process {wrong}, {when}; {stands}"}
