"""Supervisor of a servo process.

    supervisor ──► servo process      tracks, decides, commands
         │
         └───────► switch-off         disables the arm's drive from outside

The servo process counts its ticks in shared memory: its heartbeat. The supervisor detects a process
that has ended or no longer ticks. It then has the drive disabled, kills the process, so that it
cannot resume and move the arm, and reports the cause. In the meantime the arm stops by its own
watchdog, as commands no longer arrive. If the supervisor itself ends, the servo process ends too.
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
"""Time in s within which a failed process ends; if it has not ended by then, it is suspended."""

EventHandlers = Mapping[Any, Callable[[], None]]
"""Functions to call when objects such as pipes or sockets become readable, by object.

An error in a handler ends the run in order.
"""

NO_HANDLERS: EventHandlers = MappingProxyType({})

SwitchOff = Callable[[bool], str]
"""Function that disables the drive from outside the servo process.

Its argument is True if the arm had been enabled. It returns the state of the arm in words.
"""


def rely_on_watchdog(was_enabled: bool) -> str:
    """Return the sentence on an arm whose drive cannot be disabled from outside: a `SwitchOff`."""
    return (
        "the arm must stop by its own watchdog: check that its drive is off and that it is at rest"
    )


class ServoProcess(ChildProcess):
    """Process that runs a session, with its heartbeat in shared memory.

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
        self._last_heartbeat, self._silent_polls, self._due_ns = IDLE, 0, 0

    def has_failed(self) -> bool:
        """Return True if the process has ended or is silent, at most once per `POLL_NS`."""
        now_ns = time.monotonic_ns()
        if now_ns < self._due_ns:
            return False
        self._due_ns = now_ns + POLL_NS
        heartbeat = self._servo.heartbeat.value
        is_silent = heartbeat == self._last_heartbeat and heartbeat >= 0
        self._silent_polls = self._silent_polls + 1 if is_silent else 0
        self._last_heartbeat = heartbeat
        has_ended = self._servo.process.exitcode is not None
        return has_ended or self._silent_polls >= MAX_SILENT_POLLS


def ignore_report(report: Report) -> None:
    """Discard a report."""


def run_live(
    session: Session,
    switch_off: SwitchOff = rely_on_watchdog,
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
    switch_off : SwitchOff
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
        servo = ServoProcess(session)
        try:
            return supervise(servo, switch_off, progress, handlers)
        except (KeyboardInterrupt, Stopped, OSError):  # OSError: the terminal is closed
            servo.send("end")
            with contextlib.suppress(RcmServoError):
                supervise(servo, switch_off)
            raise
        finally:
            servo.end()


def supervise(
    servo: ServoProcess,
    switch_off: SwitchOff,
    progress: Callable[[Report], None] = ignore_report,
    handlers: EventHandlers = NO_HANDLERS,
) -> RunResult:
    """Supervise a servo process until it reports its result or fails; return the result.

    The parameters and errors are those of `run_live`.
    """
    monitor, enabled_ns = HeartbeatMonitor(servo), 0
    pipes = [servo.pipe]
    while True:
        ready = wait([*pipes, *handlers], POLL_NS * 1e-9) if pipes or handlers else []
        for source in handlers.keys() & ready:
            handlers[source]()
        if servo.pipe in pipes and servo.pipe in ready:
            message = _receive(servo.pipe)
            if isinstance(message, Report):
                progress(message)
            elif message is not None:
                return _check_result(message)
            else:
                pipes.clear()
                servo.process.join(EXIT_TIMEOUT_S)
        if not enabled_ns and servo.heartbeat.value != IDLE:
            enabled_ns = time.monotonic_ns()
        if monitor.has_failed() and not any(pipe.poll() for pipe in pipes):
            return _handle_failure(servo, switch_off, enabled_ns)


def _receive(pipe: Connection) -> Any:
    """Return the next message of the servo process, or None if it has ended."""
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None


def _check_result(message: Any) -> RunResult:
    """Return the result of the servo process, or raise the error that it sent instead."""
    if isinstance(message, RcmServoError):
        raise message
    if isinstance(message, str):
        raise RuntimeError(f"the servo process failed:\n{message}")
    return cast(RunResult, message)


def _handle_failure(servo: ServoProcess, switch_off: SwitchOff, enabled_ns: int) -> RunResult:
    """Disable the drive, kill the process, and return the result with the cause.

    `enabled_ns` is the time at which the arm was enabled, 0 if it was not.
    """
    failed_ns = time.monotonic_ns()
    arm_state = switch_off(enabled_ns > 0)
    servo.process.join(KILL_TIMEOUT_S)
    ending = _describe_exit(servo.process.exitcode)
    servo.process.kill()
    servo.process.join()
    run_time = f"{(failed_ns - enabled_ns) * 1e-9:.1f} s into the run"
    moment = run_time if enabled_ns else "before the arm was enabled"
    return RunResult(cause=f"the servo process {ending}, {moment}; {arm_state}")


def _describe_exit(code: int | None) -> str:
    if code is None:
        return "was stopped: its loop did not tick"
    if code < 0:
        return f"was killed ({signal.Signals(-code).name})"
    return f"ended by itself (exit code {code})"
