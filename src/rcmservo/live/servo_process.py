"""Servo process: opens the devices, prepares them, and runs the loop.

All devices are connected, the target is taught, and the kernels are compiled before the arm is
enabled. From then on the process runs the loop, which never waits, a thread that tracks the
markers, and two threads that record and report the ticks.
"""

import contextlib
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import numpy as np

from rcmservo.errors import RcmServoError, Stopped
from rcmservo.interfaces import Arm, Camera, Command, Floats, Frame, Target, Tracker
from rcmservo.live.loop_statistics import ReportThread
from rcmservo.live.realtime import realtime
from rcmservo.live.stop_signals import EndRequest
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import RecordingClock, WallClock, ticks
from rcmservo.loop.detection_failure import reason_not_detected
from rcmservo.loop.operator import Operator
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import run
from rcmservo.loop.run_result import CameraStatistics, RunResult
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import find_stop_cause
from rcmservo.recording.writer import Recorder, ThreadedRecorder
from rcmservo.servo.servo import Servo

IDLE, ENABLING = -1, -2
"""Values of the heartbeat while no loop runs, and while the drive is being enabled."""

FRAME_TIMEOUT_S = 120.0
"""Time in s within which a camera must deliver a frame and the tracker must be compiled."""

Device = TypeVar("Device")


class NoFrames(RcmServoError):
    """Report a camera that delivers no usable frame."""


@dataclass(frozen=True)
class Session:
    """Parts of a live run.

    The devices are made in the servo process, which is spawned. Each is therefore given as a
    factory that can be imported there: a function of a module, or `functools.partial` of one with
    plain arguments. A device that has a method `close` is closed at the end.

    Parameters
    ----------
    servo : Servo
        Initial settings of the servo.
    duration : float
        Length of the run, s.
    arm : Callable[[], Arm]
        Function that connects to the arm.
    camera : Callable[[], Camera]
        Function that opens the camera.
    tracker : Callable[[], Tracker]
        Function that makes the marker tracker.
    recorder : Callable[[], Recorder]
        Function that opens the record.
    target : Callable[[Plant], Target]
        Function that obtains the target before the drive is on. By default it teaches the
        present image.
    operator : Callable[[], Operator] or None
        Function that makes the operator of the loop; without one a pause ends the run.
    images_per_s : float
        Images per second in the record, 1/s; 0 for none.
    consent : Callable[[Plant], None] or None
        Function that is called just before the drive is enabled, and raises an error to prevent
        it; by default there is none.
    """

    servo: Servo
    duration: float
    arm: Callable[[], Arm]
    camera: Callable[[], Camera]
    tracker: Callable[[], Tracker]
    recorder: Callable[[], Recorder]
    target: Callable[[Plant], Target] = teach
    operator: Callable[[], Operator] | None = None
    images_per_s: float = 0.0
    consent: Callable[[Plant], None] | None = None


class HeartbeatPlant(Plant):
    """Plant that counts its commands once the drive is on, including those that stop the arm.

    Parameters
    ----------
    arm : Arm
        Arm of the plant.
    eye : TrackingThread
        Camera and tracker.
    clock : RecordingClock
        Clock that records the lateness of each tick.
    heartbeat : RawValue
        Heartbeat in shared memory.
    stop_requested : EndRequest
        Stop request. Code that waits for the operator must poll it.
    consent : Callable or None
        Function that is called just before the drive is enabled.
    """

    def __init__(
        self,
        arm: Arm,
        eye: TrackingThread,
        clock: RecordingClock,
        heartbeat: Any,
        stop_requested: EndRequest,
        consent: Callable[[Plant], None] | None = None,
    ) -> None:
        super().__init__(arm, eye, eye, clock)
        self.lateness, self.heartbeat, self.stop_requested = (
            clock.lateness,
            heartbeat,
            stop_requested,
        )
        self._consent = consent

    def enable(self) -> None:
        if self._consent is not None:
            self._consent(self)
        self.heartbeat.value = ENABLING
        raise_if_stopped(self.stop_requested)
        super().enable()
        self.heartbeat.value = 0
        del self.lateness[:]  # no tick was due while the drive was being enabled

    def send(self, command: Command) -> Floats:
        if self.heartbeat.value >= 0:
            self.heartbeat.value += 1
        return super().send(command)


class FrameSampler:
    """Selection of the frames that are recorded as images.

    Parameters
    ----------
    rate : float
        Images per second, 1/s; 0 for none.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1e9 / rate if rate > 0.0 else np.inf
        self._due = 0.0 if rate > 0.0 else np.inf
        self._shown: Frame | None = None

    def sample(self, tick: Tick, frame: Frame | None) -> Frame | None:
        """Return the frame of a tick if it is due, else None."""
        if tick.time < self._due or frame is None or frame is self._shown:
            return None
        self._due, self._shown = tick.time + self._period, frame
        return frame


def run_session(session: Session, heartbeat: Any, supervisor: Connection) -> None:
    """Run a session until it ends or the supervisor requests its end or is gone.

    The supervisor receives reports during the run. At the end it receives a RunResult, an
    RcmServoError, or the traceback (str) of an internal error.

    Parameters
    ----------
    session : Session
        Parts of the run.
    heartbeat : RawValue
        Heartbeat in shared memory, which counts the commands while the loop runs.
    supervisor : Connection
        Pipe to the supervisor.
    """
    stop_requested = EndRequest(supervisor)
    stop_requested.handle_signals()
    heartbeat.value = IDLE
    try:
        message: Any = _live(session, heartbeat, supervisor, stop_requested)
    except Stopped as stopped:
        message = stopped
    except RcmServoError as error:
        message = RcmServoError(str(error))
    except Exception:
        message = traceback.format_exc()
    with contextlib.suppress(OSError):  # the supervisor may be gone
        supervisor.send(message)


def _live(
    session: Session, heartbeat: Any, supervisor: Connection, stop_requested: EndRequest
) -> RunResult:
    """Open the devices, run, and return the result.

    The reason for a drive that went off by itself is complete only after the arm is closed.
    """
    clock = RecordingClock(WallClock())
    with contextlib.ExitStack() as stack:
        arm, camera = _open(session.arm, stack), _open(session.camera, stack)
        tracker = _open(session.tracker, stack)
        operator = None if session.operator is None else _open(session.operator, stack)
        eye = stack.enter_context(TrackingThread(camera, tracker, clock.clock))
        plant = HeartbeatPlant(arm, eye, clock, heartbeat, stop_requested, session.consent)
        target = _prepare_target(session, plant)
        result = _run_loop(session, plant, target, operator, supervisor)
        result = replace(result, camera=_camera_counts(camera))
    off = getattr(arm, "off_reason", "")
    return replace(result.unsettled(result.cause or off), drive_off=off) if off else result


def _camera_counts(camera: object) -> CameraStatistics | None:
    """Return the counts of a camera's frames, or None if it has none."""
    counts = getattr(camera, "counts", None)
    return None if counts is None else counts()


def _open(make: Callable[[], Device], stack: contextlib.ExitStack) -> Device:
    """Return the device of a factory, which the stack closes."""
    device = make()
    close = getattr(device, "close", None)
    if close is not None:
        stack.callback(close)
    return device


def _prepare_target(session: Session, plant: HeartbeatPlant) -> Target:
    """Return the target, once everything is loaded.

    The tracker searches the first frame and follows the markers in the second, so both parts are
    then loaded. The frame at the end is exposed after the target was taught.
    """
    for _ in range(2):
        _await_frame(plant)
    target = session.target(plant)
    _await_frame(plant)
    return target


def raise_if_stopped(stop_requested: Callable[[], bool]) -> None:
    """Raise `Stopped` if the end of this process is requested."""
    if stop_requested():
        raise Stopped("stopped before the drive was on")


def _await_frame(plant: HeartbeatPlant) -> None:
    """Wait for a frame that is exposed from now on."""
    now, why = plant.clock.now(), ""
    for _ in ticks(plant.clock, duration=FRAME_TIMEOUT_S):
        observation = plant.read()
        raise_if_stopped(plant.stop_requested)
        if observation.exposure >= now:
            return
        why = observation.drop_reason.text
    raise NoFrames(f"no usable frame has arrived for {FRAME_TIMEOUT_S:g} s{why and ': ' + why}")


def _run_loop(
    session: Session,
    plant: HeartbeatPlant,
    target: Target,
    operator: Operator | None,
    supervisor: Connection,
) -> RunResult:
    """Run the loop, with record and reports in threads."""
    servo, duration = session.servo, session.duration
    with (
        ThreadedRecorder(session.recorder()) as recorder,
        ReportThread(servo, target, supervisor) as reports,
    ):
        recorder.begin(servo, target)
        servo.warm_up()
        plant.recorded = recorder.recorded
        with realtime() as system:

            def stop_requested(tick: Tick) -> bool:
                return plant.stop_requested()

            raise_if_stopped(plant.stop_requested)
            start, film = plant.clock.now(), FrameSampler(session.images_per_s)
            try:
                for tick in run(plant, servo, target, duration, stop_requested, operator=operator):
                    recorder.write(tick)
                    reports.put(tick)
                    picture = film.sample(tick, plant.frame)
                    if picture is not None:
                        recorder.write_frame(picture)
            finally:
                plant.heartbeat.value = IDLE
    timing = reports.timing(np.array(plant.lateness, dtype=float), system)
    result, undetected_tick = reports.judge.result(), reports.judge.last_tick_without_markers
    if plant.stop_requested.signal:
        result = result.unsettled(f"the run was stopped by {plant.stop_requested.signal}")
    elif undetected_tick is not None:
        cause = find_stop_cause(
            undetected_tick.state.mode,
            reason_not_detected(plant, undetected_tick.observation, start),
        )
        result = replace(result, cause=cause or result.cause)
    return replace(result, not_recorded=recorder.failed, loop=timing)
