"""Supervisor of a servo process.

    supervisor ──► servo process      tracks, decides, commands
         │
         └───────► switch-off         disables the arm's drive from outside

The arm stops by itself when commands stop. The supervisor detects the reason: a servo process that
has ended or no longer ticks. It then has the drive disabled, kills the servo process, so that it
cannot resume and move the arm, and reports the cause. If the supervisor itself ends, the servo
process ends by itself.
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
from rcmservo.live.servo_process import IDLE, Session, run_session
from rcmservo.live.stop_signals import stopped_by_signals
from rcmservo.loop.run_result import RunResult

POLL_NS = 10_000_000
"""Interval in ns at which the heartbeat of the servo process is read."""

MAX_SILENT_POLLS = 10
"""Number of successive polls without a heartbeat after which the process is stopped.

Polls are counted instead of time, so that a stall of the whole computer does not count against the
servo process.
"""

KILL_TIMEOUT_S = 0.5
"""Time in s within which a killed process ends; one that has not ended was only suspended."""

EventHandlers = Mapping[Any, Callable[[], None]]
"""Handlers of other events, by an object to wait for (`fileno`).

An error in a handler ends the run in order.
"""

NO_HANDLERS: EventHandlers = MappingProxyType({})

SwitchOff = Callable[[bool], str]
"""Function that disables the drive from outside the servo process.

Its argument is True if the arm had been enabled. It returns the state of the arm in words.
"""


def rely_on_watchdog(began: bool) -> str:
    """Return the sentence on an arm whose drive cannot be disabled from outside."""
    return (
        "the arm must stop by its own watchdog: check that its drive is off and that it is at rest"
    )


class ServoProcess(ChildProcess):
    """Process that runs a session, and its heartbeat.

    Parameters
    ----------
    session : Session
        Parts of the run.
    context : Context or None
        Start method of the process; spawn by default.
    """

    def __init__(self, session: Session, context: Context | None = None) -> None:
        context = get_context("spawn") if context is None else context
        self.heartbeat: Any = context.RawValue("q", IDLE)
        super().__init__(context, run_session, session, self.heartbeat)


class HeartbeatMonitor:
    """Check that a servo process exists, and that its heartbeat advances while its loop runs.

    Parameters
    ----------
    servo : ServoProcess
        Process to check.
    """

    def __init__(self, servo: ServoProcess) -> None:
        self._servo = servo
        self._last, self._still, self._due = IDLE, 0, 0

    def has_failed(self) -> bool:
        """Return True if the process has failed; poll at most once per `POLL_NS`."""
        now = time.monotonic_ns()
        if now < self._due:
            return False
        self._due = now + POLL_NS
        beat = self._servo.heartbeat.value
        self._still = self._still + 1 if beat == self._last and beat >= 0 else 0
        self._last = beat
        return self._still >= MAX_SILENT_POLLS or self._servo.process.exitcode is not None


def ignore_report(report: Report) -> None:
    """Discard a report."""


def run_live(
    session: Session,
    off: SwitchOff = rely_on_watchdog,
    progress: Callable[[Report], None] = ignore_report,
    handlers: EventHandlers = NO_HANDLERS,
) -> RunResult:
    """Run a session in a separate process in wall time, and supervise it.

    Ctrl-C, SIGTERM and a closed terminal let the servo stop the arm and complete its record. The
    exception is raised afterwards.

    Parameters
    ----------
    session : Session
        Parts of the run.
    off : SwitchOff
        Function that disables the drive from outside the servo process.
    progress : Callable
        Function that receives each report.
    handlers : EventHandlers
        Handlers of other events during the run.

    Returns
    -------
    RunResult
        Result of the run.

    Raises
    ------
    Stopped
        After a signal or a stop request.
    RcmServoError
        If the session reports an error.
    RuntimeError
        If the servo process has an internal error.
    """
    with stopped_by_signals(), without_huge_pages():
        return _run_live(session, off, progress, handlers)


def _run_live(
    session: Session, off: SwitchOff, progress: Callable[[Report], None], handlers: EventHandlers
) -> RunResult:
    servo = ServoProcess(session)
    try:
        return supervise(servo, off, progress, handlers)
    except (KeyboardInterrupt, Stopped, OSError):  # OSError: the terminal is closed
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
    handlers: EventHandlers = NO_HANDLERS,
) -> RunResult:
    """Supervise a servo process until it reports its result or fails; return the result."""
    monitor, began = HeartbeatMonitor(servo), 0
    pipes = [servo.pipe]
    while True:
        ready = wait([*pipes, *handlers], POLL_NS * 1e-9) if pipes or handlers else []
        for source in handlers.keys() & ready:
            handlers[source]()
        for pipe in cast(list[Connection], [one for one in ready if one in pipes]):
            message = _receive(pipe)
            if isinstance(message, Report):
                progress(message)
            elif message is not None:
                return _result(message)
            else:
                pipes.clear()
                servo.process.join(EXIT_TIMEOUT_S)
        if not began and servo.heartbeat.value != IDLE:
            began = time.monotonic_ns()
        if monitor.has_failed() and not any(pipe.poll() for pipe in pipes):
            return _handle_failure(servo, off, began)


def _receive(pipe: Connection) -> Any:
    """Return the next message of the servo process, or None if it has ended."""
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None


def _result(message: Any) -> RunResult:
    if isinstance(message, RcmServoError):
        raise message
    if isinstance(message, str):
        raise RuntimeError(f"the servo process failed:\n{message}")
    return cast(RunResult, message)


def _handle_failure(servo: ServoProcess, off: SwitchOff, began: int) -> RunResult:
    """Disable the drive, kill the process, and return the result with the cause."""
    now = time.monotonic_ns()
    arm_state = off(began > 0)
    servo.process.join(KILL_TIMEOUT_S)
    exit_description = _describe_exit(servo.process.exitcode)
    servo.process.kill()
    servo.process.join()
    when = f"{(now - began) * 1e-9:.1f} s into the run" if began else "before the arm was enabled"
    cause = f"the servo process {exit_description}, {when}; {arm_state}"
    return RunResult(cause=cause)


def _describe_exit(code: int | None) -> str:
    if code is None:
        return "was stopped: its loop did not tick"
    if code < 0:
        return f"was killed ({signal.Signals(-code).name})"
    return f"ended by itself (exit code {code})"
