"""Servo process: it opens and prepares the devices, and runs the loop.

All devices are connected, the target is taught, and the kernels are compiled before the arm is
enabled. From then on the process has four threads: the loop, which never waits, one that tracks the
markers, and two that record and report the ticks.
"""

import contextlib
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from rcmservo.errors import RcmServoError, Stopped
from rcmservo.interfaces import Arm, Command, Floats, Frame, Target
from rcmservo.live.device_protocols import DeviceBundle, close_at_end
from rcmservo.live.loop_statistics import ReportThread
from rcmservo.live.realtime import apply_realtime_settings
from rcmservo.live.stop_signals import EndRequest
from rcmservo.live.tracking_thread import TrackingThread
from rcmservo.loop.clock import RecordingClock, WallClock, ticks
from rcmservo.loop.detection_failure import explain_undetected_markers
from rcmservo.loop.operator import Operator
from rcmservo.loop.plant import Plant
from rcmservo.loop.run_result import RunResult
from rcmservo.loop.servo_loop import servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.loop.tick import Tick
from rcmservo.recording.outcome import OutcomeCollector, find_stop_cause
from rcmservo.recording.writer import Recorder, ThreadedRecorder
from rcmservo.servo.servo import Servo

IDLE, ENABLING = -1, -2
"""Values of the heartbeat while no loop runs, and while the drive is being enabled.

At other times the heartbeat is the number of commands so far.
"""

FIRST_FRAME_TIMEOUT_S = 120.0
"""Time in s within which a camera must deliver a frame and the tracker must be compiled."""


class NoFrames(RcmServoError):
    """Error of a camera that delivers no usable frame."""


@dataclass(frozen=True)
class Session:
    """Parts of a live run.

    The devices are connected in the servo process, which is spawned. The rig is therefore not
    connected yet, and its functions and those below can be imported there: each is a function of a
    module, or `functools.partial` of one with plain arguments.

    Parameters
    ----------
    servo : Servo
        Settings of the servo at the start.
    duration : float
        Length of the run, s.
    rig : DeviceBundle
        Arm, camera and tracker: a `LazyRig`.
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
        Function that is called just before the drive is enabled. It raises an error to prevent
        that. By default there is none.
    """

    servo: Servo
    duration: float
    rig: DeviceBundle
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
    camera : TrackingThread
        Camera and tracker.
    clock : RecordingClock
        Clock that records the lateness of each tick.
    heartbeat : RawValue
        Heartbeat in shared memory.
    stop_requested : EndRequest
        Function that returns True once the end of the process is requested. Code that waits for the
        operator must poll it.
    consent : Callable or None
        Function that is called just before the drive is enabled.
    """

    def __init__(
        self,
        arm: Arm,
        camera: TrackingThread,
        clock: RecordingClock,
        heartbeat: Any,
        stop_requested: EndRequest,
        consent: Callable[[Plant], None] | None = None,
    ) -> None:
        super().__init__(arm, camera, camera, clock)
        self.lateness, self.heartbeat = clock.lateness, heartbeat
        self.stop_requested, self._consent = stop_requested, consent

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
    """Selector of the frames that are recorded as images.

    Parameters
    ----------
    rate : float
        Images per second, 1/s; 0 for none.
    """

    def __init__(self, rate: float) -> None:
        self._period_ns = 1e9 / rate if rate > 0.0 else np.inf
        self._due_ns = 0.0 if rate > 0.0 else np.inf
        self._last_frame: Frame | None = None

    def sample(self, tick: Tick, frame: Frame | None) -> Frame | None:
        """Return the frame of a tick if an image is due, else None."""
        if tick.time < self._due_ns or frame is None or frame is self._last_frame:
            return None
        self._due_ns, self._last_frame = tick.time + self._period_ns, frame
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
    stop_requested.install_handlers()
    heartbeat.value = IDLE
    try:
        message: Any = _run_devices(session, heartbeat, supervisor, stop_requested)
    except Stopped as stopped:
        message = stopped
    except RcmServoError as error:
        message = RcmServoError(str(error))
    except Exception:
        message = traceback.format_exc()
    with contextlib.suppress(OSError):  # the supervisor may be gone
        supervisor.send(message)


def _run_devices(
    session: Session, heartbeat: Any, supervisor: Connection, stop_requested: EndRequest
) -> RunResult:
    """Open the devices, run, close the devices, and return the result.

    The reason for a drive that went off by itself is complete only after the arm is closed.
    """
    clock = RecordingClock(WallClock())
    with contextlib.ExitStack() as stack:
        stack.enter_context(session.rig.connected())
        arm, camera = session.rig.arm, session.rig.camera
        operator = None if session.operator is None else session.operator()
        close_at_end(operator, stack)
        tracking = stack.enter_context(TrackingThread(camera, session.rig.tracker, clock.clock))
        plant = HeartbeatPlant(arm, tracking, clock, heartbeat, stop_requested, session.consent)
        target = _prepare_target(session, plant)
        result = _run_loop(session, plant, target, operator, supervisor)
        count_frames = getattr(camera, "counts", None)
        result = replace(result, camera=None if count_frames is None else count_frames())
    off_reason = getattr(arm, "off_reason", "")
    if not off_reason:
        return result
    return replace(result.unsettled(result.cause or off_reason), drive_off=off_reason)


def _prepare_target(session: Session, plant: HeartbeatPlant) -> Target:
    """Return the target, once the kernels of the tracker are compiled.

    The tracker searches the whole first frame and only near the markers in the second, so both of
    its parts are then compiled. The frame at the end is exposed after the target was taught.
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
    since_ns, drop_reason = plant.clock.now(), ""
    for _ in ticks(plant.clock, duration=FIRST_FRAME_TIMEOUT_S):
        observation = plant.read()
        raise_if_stopped(plant.stop_requested)
        if observation.exposure >= since_ns:
            return
        drop_reason = observation.drop_reason.text
    reason = f": {drop_reason}" if drop_reason else ""
    raise NoFrames(f"no usable frame has arrived for {FIRST_FRAME_TIMEOUT_S:g} s{reason}")


def _run_loop(
    session: Session,
    plant: HeartbeatPlant,
    target: Target,
    operator: Operator | None,
    supervisor: Connection,
) -> RunResult:
    """Run the loop, with record and reports in threads."""
    servo, duration = session.servo, session.duration
    sampler = FrameSampler(session.images_per_s)
    with (
        ThreadedRecorder(session.recorder()) as recorder,
        ReportThread(servo, target, supervisor) as reports,
    ):
        recorder.begin(servo, target)
        servo.warm_up()
        plant.recorded = recorder.recorded
        with apply_realtime_settings() as system:

            def is_done(tick: Tick) -> bool:
                return plant.stop_requested()

            raise_if_stopped(plant.stop_requested)
            began_ns = plant.clock.now()
            try:
                for tick in servo_ticks(plant, servo, target, duration, is_done, operator=operator):
                    recorder.write(tick)
                    reports.put(tick)
                    sampled_frame = sampler.sample(tick, plant.frame)
                    if sampled_frame is not None:
                        recorder.write_frame(sampled_frame)
            finally:
                plant.heartbeat.value = IDLE
    timing = reports.compute_timing(np.array(plant.lateness, dtype=float), system)
    result = _find_cause(reports.outcome, plant, began_ns)
    return replace(result, not_recorded=recorder.failed, loop=timing)


def _find_cause(outcome: OutcomeCollector, plant: HeartbeatPlant, began_ns: int) -> RunResult:
    """Return the result with the cause of a signal or of markers that were never detected."""
    result, last_tick = outcome.compute_result(), outcome.last_tick_without_markers
    if plant.stop_requested.signal:
        return result.unsettled(f"the run was stopped by {plant.stop_requested.signal}")
    if last_tick is None:
        return result
    detection_failure = explain_undetected_markers(plant, last_tick.observation, began_ns)
    cause = find_stop_cause(last_tick.state.mode, detection_failure)
    return replace(result, cause=cause or result.cause)
