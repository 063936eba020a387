"""The one who watches over a servo process.

    supervisor ──► servo process      tracks, decides, commands
         │
         └───────► whoever can switch the arm's drive off from outside

The arm stops by itself when commands stop. The supervisor is the one who notices why: a servo
process that is gone or does not tick any more. It has the drive switched off, ends the servo for
good, so that nobody can wake it up to move the arm, and says what happened. When the supervisor
itself is gone, the servo process ends by itself.
"""

import contextlib
import signal
import time
from collections.abc import Callable, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from types import MappingProxyType
from typing import Any, cast

from rcmservo.errors import RcmServoError, Stopped
from rcmservo.live.child_process import EXIT_TIMEOUT_S, ChildProcess, Context
from rcmservo.live.loop_statistics import Report
from rcmservo.live.realtime import without_huge_pages
from rcmservo.live.servo_process import IDLE, Session, serve
from rcmservo.live.stop_signals import stopped_by_signals
from rcmservo.loop.run_result import RunResult

POLL_NS = 10_000_000
"""ns between looks at the servo's heartbeat."""

MAX_SILENT_POLLS = 10
"""Looks in a row at which the heartbeat stood still: then the servo process is stopped. Counting
looks, not time, makes no difference between the servo and the watching process when the whole
computer stalls."""

KILL_TIMEOUT_S = 0.5
"""s that a process which is killed needs at most to be gone; one that is not is only stopped."""

Beside = Mapping[Any, Callable[[], None]]
"""What else there is to be heard, by something to wait for (`fileno`), and what to do then. What
that raises ends the run in order."""

NOTHING: Beside = MappingProxyType({})

SwitchOff = Callable[[bool], str]
"""Has the arm's drive switched off from outside of the servo process, and says in words how the arm
stands. It is told whether the arm had been enabled."""


def rely_on_watchdog(began: bool) -> str:
    """The words of somebody who cannot switch the drive off."""
    return "the arm is left to its own watchdog, if it has one: see that it is off and stands still"


class ServoProcess(ChildProcess):
    """A process that runs a session, and its heartbeat."""

    def __init__(self, session: Session, context: Context | None = None) -> None:
        context = get_context("spawn") if context is None else context
        self.beats: Any = context.RawValue("q", IDLE)
        super().__init__(context, serve, session, self.beats)


class HeartbeatMonitor:
    """Watches a servo process: whether it is gone, and whether its heart beats while its loop
    runs.
    """

    def __init__(self, servo: ServoProcess) -> None:
        self._servo = servo
        self._last, self._still, self._due = IDLE, 0, 0

    def has_failed(self) -> bool:
        """Whether something is wrong with the process; it looks at most once in LOOK."""
        now = time.monotonic_ns()
        if now < self._due:
            return False
        self._due = now + POLL_NS
        beat = self._servo.beats.value
        self._still = self._still + 1 if beat == self._last and beat >= 0 else 0
        self._last = beat
        return self._still >= MAX_SILENT_POLLS or self._servo.process.exitcode is not None


def ignore_report(report: Report) -> None:
    """Listens to no report."""


def run_live(
    session: Session,
    off: SwitchOff = rely_on_watchdog,
    progress: Callable[[Report], None] = ignore_report,
    beside: Beside = NOTHING,
) -> RunResult:
    """Run a session in a process of its own, in wall time, and watch over it. Meanwhile what is
    there to be heard ``beside`` is.

    Ctrl-C, a signal that ends a program in order, a terminal that is closed: each lets the servo
    bring the arm to rest and end its record, and is then raised.
    """
    with stopped_by_signals(), without_huge_pages():
        return _run_live(session, off, progress, beside)


def _run_live(
    session: Session, off: SwitchOff, progress: Callable[[Report], None], beside: Beside
) -> RunResult:
    servo = ServoProcess(session)
    try:
        return supervise(servo, off, progress, beside)
    except (KeyboardInterrupt, Stopped, OSError):  # OSError of a terminal that shows no progress
        servo.send("end")
        with contextlib.suppress(RcmServoError):
            supervise(servo, off)
        raise
    finally:
        servo.end()


def supervise(
    servo: ServoProcess,
    off: SwitchOff,
    progress: Callable[[Report], None] = ignore_report,
    beside: Beside = NOTHING,
) -> RunResult:
    """Watch over a servo process until it has told how its run went, or cannot any more."""
    watchman, began = HeartbeatMonitor(servo), 0
    ears = [servo.pipe]
    while True:
        heard = wait([*ears, *beside], POLL_NS * 1e-9) if ears or beside else []
        for other in beside.keys() & heard:
            beside[other]()
        for wire in cast(list[Connection], [one for one in heard if one in ears]):
            said = _receive(wire)
            if isinstance(said, Report):
                progress(said)
            elif said is not None:
                return _result(said)
            else:
                ears.clear()
                servo.process.join(EXIT_TIMEOUT_S)
        if not began and servo.beats.value != IDLE:
            began = time.monotonic_ns()
        if watchman.has_failed() and not any(wire.poll() for wire in ears):
            return _handle_failure(servo, off, began)


def _receive(wire: Connection) -> Any:
    """What the servo process says next; None where it can say nothing more."""
    try:
        return wire.recv()
    except (EOFError, OSError):
        return None


def _result(said: Any) -> RunResult:
    if isinstance(said, RcmServoError):
        raise said
    if isinstance(said, str):
        raise RuntimeError(f"the servo process failed:\n{said}")
    return cast(RunResult, said)


def _handle_failure(servo: ServoProcess, off: SwitchOff, began: int) -> RunResult:
    """Make sure that the arm stands still and stays so, and say what happened."""
    now = time.monotonic_ns()
    stands = off(began > 0)
    servo.process.join(KILL_TIMEOUT_S)
    wrong = _describe_exit(servo.process.exitcode)
    servo.process.kill()
    servo.process.join()
    when = f"{(now - began) * 1e-9:.1f} s into the run" if began else "before the arm was enabled"
    cause = f"the servo process {wrong}, {when}; {stands}"
    return RunResult(cause=cause)


def _describe_exit(code: int | None) -> str:
    if code is None:
        return "was stopped: it did not tick any more"
    if code < 0:
        return f"was killed ({signal.Signals(-code).name})"
    return f"ended by itself (exit code {code})"
