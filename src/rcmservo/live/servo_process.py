"""The process that servos: it makes its devices, gets everything ready, and runs the loop.

Everything is connected, taught, compiled and warmed up before the arm is enabled. While it is, this
process does three things: the loop, which waits for nobody; markers are tracked in a thread beside
it; ticks are recorded and reported in two more.
"""

import contextlib
import signal
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import numpy as np

from rcmservo.errors import RcmServoError
from rcmservo.interfaces import Arm, Camera, Command, Floats, Target, Tracker
from rcmservo.live.lab import Stopped
from rcmservo.live.realtime import realtime
from rcmservo.live.reports import LiveResult, ReportThread
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import Punctuality, WallClock, ticks
from rcmservo.loop.operator import Operator
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import run
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.loop.unseen import unseen
from rcmservo.record.verdict import held
from rcmservo.record.writer import Recorder, ThreadedRecorder
from rcmservo.servo.servo import Servo

STANDING, ENABLING = -1, -2
"""What the heartbeat tells while no loop runs, and while the drive comes on."""

PATIENCE = 120.0
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
    """

    servo: Servo
    """Its settings at the start."""
    duration: float
    """Length of the run, s."""
    arm: Callable[[], Arm]
    """Connects to the arm."""
    camera: Callable[[], Camera]
    """Opens the camera."""
    tracker: Callable[[], Tracker]
    """Makes what finds the markers in its frames."""
    recorder: Callable[[], Recorder]
    """Opens the record."""
    target: Callable[[Plant], Target] = teach
    """Gets the target, before the drive is on. By default it is what the camera sees then."""
    operator: Callable[[], Operator] | None = None
    """Makes the person beside the loop; without one a pause ends the run."""


class HeartbeatPlant(Plant):
    """A plant that counts its commands in ``beats`` once the drive is on, also those that bring
    the arm to rest."""

    def __init__(self, arm: Arm, eye: TrackingThread, clock: Punctuality, beats: Any) -> None:
        super().__init__(arm, eye, eye, clock)
        self.lateness, self.beats = clock.lateness, beats

    def enable(self) -> None:
        self.beats.value = ENABLING
        super().enable()
        self.beats.value = 0
        del self.lateness[:]  # no tick was due while the drive came on

    def send(self, command: Command) -> Floats:
        if self.beats.value >= 0:
            self.beats.value += 1
        return super().send(command)


def serve(session: Session, beats: Any, supervisor: Connection) -> None:
    """Servo until the session is done, or until the supervisor speaks or is gone.

    ``beats`` counts the ticks while the loop runs. What is sent: a Report now and then, at the end
    a LiveResult, an RcmServoError, or, of an error in the software, its traceback (str).
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    beats.value = STANDING
    try:
        said: Any = _live(session, beats, supervisor)
    except RcmServoError as error:
        said = RcmServoError(str(error))
    except Exception:
        said = traceback.format_exc()
    with contextlib.suppress(OSError):  # of a supervisor that is gone
        supervisor.send(said)


def _live(session: Session, beats: Any, supervisor: Connection) -> LiveResult:
    """Make the devices, run, and tell how it went."""
    clock = Punctuality(WallClock())
    with contextlib.ExitStack() as stack:
        arm, camera = _made(session.arm, stack), _made(session.camera, stack)
        tracker = _made(session.tracker, stack)
        operator = None if session.operator is None else _made(session.operator, stack)
        eye = stack.enter_context(TrackingThread(camera, tracker, clock.clock))
        plant = HeartbeatPlant(arm, eye, clock, beats)
        target = _target(session, plant, supervisor)
        return _servoed(session, plant, target, operator, supervisor)


def _made(make: Callable[[], Device], stack: contextlib.ExitStack) -> Device:
    """What a factory makes, to be closed at the end if it can be."""
    device = make()
    close = getattr(device, "close", None)
    if close is not None:
        stack.callback(close)
    return device


def _target(session: Session, plant: Plant, supervisor: Connection) -> Target:
    """The target, with everything warm: the first frame is searched, the next is followed, and
    after both nothing needs to be loaded. At the end the newest frame shows the tool as it is."""
    for _ in range(2):
        _await_frame(plant, supervisor)
    target = session.target(plant)
    _await_frame(plant, supervisor)
    return target


def _go_on(supervisor: Connection) -> None:
    """Stop here if the supervisor has spoken or is gone."""
    if supervisor.poll():
        raise Stopped("stopped before the drive was on")


def _await_frame(plant: Plant, supervisor: Connection) -> None:
    """Wait for a frame that is exposed from now on."""
    now, why = plant.clock.now(), ""
    for _ in ticks(plant.clock, duration=PATIENCE):
        seen = plant.read()
        _go_on(supervisor)
        if seen.exposure >= now:
            return
        why = seen.dropped.value
    raise NoFrames(f"no usable frame has come for {PATIENCE:g} s{why and ': ' + why}")


def _servoed(
    session: Session,
    plant: HeartbeatPlant,
    target: Target,
    operator: Operator | None,
    supervisor: Connection,
) -> LiveResult:
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
                return supervisor.poll()

            _go_on(supervisor)
            began = plant.clock.now()
            try:
                for tick in run(plant, servo, target, duration, ended, operator=operator):
                    recorder.write(tick)
                    reports.put(tick)
            finally:
                plant.beats.value = STANDING
    timing = reports.timing(np.array(plant.lateness, dtype=float), system)
    outcome, blind = reports.judge.outcome(), reports.judge.blind
    if blind is not None:
        cause = held(blind.state.mode, unseen(plant, blind.seen, began))
        outcome = replace(outcome, cause=cause or outcome.cause)
    return LiveResult(outcome, reports.target, recorder.failed, timing)
