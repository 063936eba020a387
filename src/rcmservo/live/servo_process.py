"""The process that servos: it makes its devices, gets everything ready, and runs the loop.

Everything is connected, taught, compiled and warmed up before the arm is enabled. While it is, this
process does three things: the loop, which waits for nobody; markers are tracked in a thread beside
it; ticks are recorded and reported in two more.
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
from rcmservo.loop.run_result import CameraAccount, RunResult
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import held
from rcmservo.recording.writer import Recorder, ThreadedRecorder
from rcmservo.servo.servo import Servo

IDLE, ENABLING = -1, -2
"""What the heartbeat tells while no loop runs, and while the drive comes on."""

FRAME_TIMEOUT_S = 120.0
"""s within which a camera must deliver a frame, and what tracks the markers in it be loaded or
compiled."""

Device = TypeVar("Device")


class NoFrames(RcmServoError):
    """A camera that delivers nothing of use."""


@dataclass(frozen=True)
class Session:
    """What a live run is made of.

    The devices are made in the servo process, which is spawned: so each comes as a factory that can
    be imported there, a function of a module, or `functools.partial` of one with plain arguments.
    What a factory makes is closed at the end if it has a method `close`.

    Parameters
    ----------
    servo : Servo
        Its settings at the start.
    duration : float
        Length of the run, s.
    arm : Callable[[], Arm]
        Connects to the arm.
    camera : Callable[[], Camera]
        Opens the camera.
    tracker : Callable[[], Tracker]
        Makes what finds the markers in its frames.
    recorder : Callable[[], Recorder]
        Opens the record.
    target : Callable[[Plant], Target]
        Gets the target, before the drive is on. By default it is what the camera sees then.
    operator : Callable[[], Operator] or None
        Makes the person beside the loop; without one a pause ends the run.
    pictures : float
        Pictures that the record gets, 1/s; 0 for none.
    consent : Callable[[Plant], None] or None
        Asks for leave at the last moment before the drive is switched on, and raises an error where
        it is not given; without it nobody is asked.
    """

    servo: Servo
    duration: float
    arm: Callable[[], Arm]
    camera: Callable[[], Camera]
    tracker: Callable[[], Tracker]
    recorder: Callable[[], Recorder]
    target: Callable[[Plant], Target] = teach
    operator: Callable[[], Operator] | None = None
    pictures: float = 0.0
    consent: Callable[[Plant], None] | None = None


class HeartbeatPlant(Plant):
    """A plant that counts its commands in ``beats`` once the drive is on, also those that bring
    the arm to rest. Whoever asks a person goes on asking whether it is ``told_to_end``.
    """

    def __init__(
        self,
        arm: Arm,
        eye: TrackingThread,
        clock: RecordingClock,
        beats: Any,
        told_to_end: EndRequest,
        consent: Callable[[Plant], None] | None = None,
    ) -> None:
        super().__init__(arm, eye, eye, clock)
        self.lateness, self.beats, self.told_to_end = clock.lateness, beats, told_to_end
        self._consent = consent

    def enable(self) -> None:
        if self._consent is not None:
            self._consent(self)
        self.beats.value = ENABLING
        go_on(self.told_to_end)
        super().enable()
        self.beats.value = 0
        del self.lateness[:]  # no tick was due while the drive came on

    def send(self, command: Command) -> Floats:
        if self.beats.value >= 0:
            self.beats.value += 1
        return super().send(command)


class Film:
    """Which of the frames a record gets as pictures: so many a second, or none."""

    def __init__(self, rate: float) -> None:
        self._period = 1e9 / rate if rate > 0.0 else np.inf
        self._due = 0.0 if rate > 0.0 else np.inf
        self._shown: Frame | None = None

    def picture(self, tick: Tick, frame: Frame | None) -> Frame | None:
        """The frame that a tick knows, if it is the next one."""
        if tick.time < self._due or frame is None or frame is self._shown:
            return None
        self._due, self._shown = tick.time + self._period, frame
        return frame


def serve(session: Session, beats: Any, supervisor: Connection) -> None:
    """Servo until the session is done, or until the supervisor speaks or is gone.

    ``beats`` counts the ticks while the loop runs. What is sent: a Report now and then, at the end
    a RunResult, an RcmServoError, or, of an error in the software, its traceback (str).
    """
    told_to_end = EndRequest(supervisor)
    told_to_end.handle_signals()
    beats.value = IDLE
    try:
        said: Any = _live(session, beats, supervisor, told_to_end)
    except Stopped as stopped:
        said = stopped
    except RcmServoError as error:
        said = RcmServoError(str(error))
    except Exception:
        said = traceback.format_exc()
    with contextlib.suppress(OSError):  # of a supervisor that is gone
        supervisor.send(said)


def _live(
    session: Session, beats: Any, supervisor: Connection, told_to_end: EndRequest
) -> RunResult:
    """Make the devices, run, and tell how it went. Why the arm's drive went off is known for sure
    when the arm is closed.
    """
    clock = RecordingClock(WallClock())
    with contextlib.ExitStack() as stack:
        arm, camera = _open(session.arm, stack), _open(session.camera, stack)
        tracker = _open(session.tracker, stack)
        operator = None if session.operator is None else _open(session.operator, stack)
        eye = stack.enter_context(TrackingThread(camera, tracker, clock.clock))
        plant = HeartbeatPlant(arm, eye, clock, beats, told_to_end, session.consent)
        target = _prepare_target(session, plant)
        result = _run_loop(session, plant, target, operator, supervisor)
        result = replace(result, camera=_camera_account(camera))
    off = getattr(arm, "why_off", "")
    return replace(result.unsettled(result.cause or off), drive_off=off) if off else result


def _camera_account(camera: object) -> CameraAccount | None:
    """What became of a camera's frames, if it keeps account of them."""
    account = getattr(camera, "account", None)
    return None if account is None else account()


def _open(make: Callable[[], Device], stack: contextlib.ExitStack) -> Device:
    """What a factory makes, to be closed at the end if it can be."""
    device = make()
    close = getattr(device, "close", None)
    if close is not None:
        stack.callback(close)
    return device


def _prepare_target(session: Session, plant: HeartbeatPlant) -> Target:
    """The target, with everything warm: the first frame is searched, the next is followed, and
    after both nothing needs to be loaded. At the end the newest frame shows the tool as it is.
    """
    for _ in range(2):
        _await_frame(plant)
    target = session.target(plant)
    _await_frame(plant)
    return target


def go_on(told_to_end: Callable[[], bool]) -> None:
    """Stop here if this process was told to end."""
    if told_to_end():
        raise Stopped("stopped before the drive was on")


def _await_frame(plant: HeartbeatPlant) -> None:
    """Wait for a frame that is exposed from now on."""
    now, why = plant.clock.now(), ""
    for _ in ticks(plant.clock, duration=FRAME_TIMEOUT_S):
        seen = plant.read()
        go_on(plant.told_to_end)
        if seen.exposure >= now:
            return
        why = seen.dropped.words
    raise NoFrames(f"no usable frame has come for {FRAME_TIMEOUT_S:g} s{why and ': ' + why}")


def _run_loop(
    session: Session,
    plant: HeartbeatPlant,
    target: Target,
    operator: Operator | None,
    supervisor: Connection,
) -> RunResult:
    """Run the loop, with record and reports beside it."""
    servo, duration = session.servo, session.duration
    with (
        ThreadedRecorder(session.recorder()) as recorder,
        ReportThread(servo, target, supervisor) as reports,
    ):
        recorder.begin(servo, target)
        servo.warm_up()
        plant.recorded = recorder.recorded
        with realtime() as system:

            def ended(tick: Tick) -> bool:
                return plant.told_to_end()

            go_on(plant.told_to_end)
            began, film = plant.clock.now(), Film(session.pictures)
            try:
                for tick in run(plant, servo, target, duration, ended, operator=operator):
                    recorder.write(tick)
                    reports.put(tick)
                    picture = film.picture(tick, plant.frame)
                    if picture is not None:
                        recorder.write_frame(picture)
            finally:
                plant.beats.value = IDLE
    timing = reports.timing(np.array(plant.lateness, dtype=float), system)
    result, blind = reports.judge.result(), reports.judge.blind
    if plant.told_to_end.signal:
        result = result.unsettled(f"it was ended by {plant.told_to_end.signal}")
    elif blind is not None:
        cause = held(blind.state.mode, reason_not_detected(plant, blind.seen, began))
        result = replace(result, cause=cause or result.cause)
    return replace(result, not_recorded=recorder.failed, loop=timing)
