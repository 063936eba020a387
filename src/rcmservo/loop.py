"""The only code that makes anything move: the plant put together, a target taught, and the loop run.

    plant.read() ─► servo.step() ─► plant.send()

on every tick of the plant's own clock.
"""

from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np

from rcmservo.clock import ticks
from rcmservo.errors import BadInput, RcmServoError, require
from rcmservo.plant import (
    Camera,
    Clock,
    Command,
    Dropped,
    Floats,
    Frame,
    Markers,
    Mechanism,
    Observation,
    Target,
    Tracker,
)
from rcmservo.servo import Servo, State
from rcmservo.states import Phase, Request

TEACH_TIMEOUT = 2.0
"""s without a frame that shows both markers after which teaching gives up."""

JOINT_HISTORY = 256

OLDEST = 2_000_000_000
"""ns after its exposure within which a frame must arrive, or its time cannot be right."""


class NotShown(RcmServoError):
    """A target that could not be taught, because the camera did not see both markers."""


class Plant:
    """A mechanism, a camera and a tracker as one thing that is read and sent to.

    It keeps the joints' recent past, to tell where they were when a frame was exposed, and drops frames that are not
    new, that bear impossible times or that are damaged. ``recorded`` tells whether a record that was asked for is still
    written.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        camera: Camera,
        tracker: Tracker,
        clock: Clock,
        recorded: Callable[[], bool] = lambda: True,
    ) -> None:
        self.mechanism, self.camera, self.tracker, self.clock = mechanism, camera, tracker, clock
        self.recorded = recorded
        self.markers: Markers | None = None
        self.frame: Frame | None = None
        self._offered: Frame | None = None
        self._dropped = Dropped.NONE
        self._past: deque[tuple[int, Floats]] = deque(maxlen=JOINT_HISTORY)
        self._began = 0
        self._q_exposure = np.full(3, np.nan)
        self._applied = np.zeros(3)

    def enable(self) -> None:
        """Switch the arm's drive on: a person's act."""
        self.mechanism.enable()

    def read(self) -> Observation:
        """Measure the joints, and track the markers where a new frame has arrived."""
        time, q, enabled = self.mechanism.measure()
        if not self._past:
            self._began = time
        if not self._past or time > self._past[-1][0]:
            self._past.append((time, q))
        self._look(self.camera.latest())
        frame = self.frame
        return Observation(
            now=self.clock.now(),
            q=q,
            q_time=time,
            enabled=enabled,
            applied=self._applied,
            frame=-1 if frame is None else frame.number,
            exposure=0 if frame is None else frame.exposure,
            arrival=0 if frame is None else frame.arrival,
            q_exposure=self._q_exposure,
            points=np.full((2, 2), np.nan) if self.markers is None else self.markers.points,
            dropped=self._dropped,
            recorded=self.recorded(),
        )

    def reset(self) -> None:
        """Forget where markers and joints were: a person may have moved the tool since they were last read.

        Frames exposed before the joints are read again count for nothing, and their numbers may begin anew.
        """
        self.tracker.reset()
        self._past.clear()
        self.markers = self.frame = None
        self._dropped = Dropped.NONE
        self._q_exposure = np.full(3, np.nan)

    def send(self, command: Command) -> Floats:
        """Pass a command on to the arm; the joint rates (3,) that the arm took."""
        self._applied = self.mechanism.apply(command)
        return self._applied

    def _look(self, frame: Frame | None) -> None:
        """Track the markers in a frame that was not offered before, or say why not."""
        if frame is None or frame is self._offered:
            return
        self._offered = frame
        self._dropped = self._wrong(frame)
        if self._dropped is not Dropped.NONE or frame.exposure < self._began:
            return
        try:
            self.markers = self.tracker.find(frame)
        except BadInput:
            self._dropped = Dropped.DAMAGED
            return
        self.frame = frame
        self._q_exposure = self._joints_at(frame.exposure)

    def _wrong(self, frame: Frame) -> Dropped:
        if not 0 <= frame.arrival - frame.exposure <= OLDEST or not 0 <= self.clock.now() - frame.arrival <= OLDEST:
            return Dropped.CLOCK
        last = self.frame
        if last is not None and not frame.number > last.number:
            return Dropped.NOT_NEW
        if last is not None and not frame.exposure > last.exposure:
            return Dropped.CLOCK
        return Dropped.NONE if last is None or _shape(frame) == _shape(last) else Dropped.DAMAGED

    def _joints_at(self, time: int) -> Floats:
        times = [t for t, _ in self._past]
        return np.array([np.interp(time, times, [q[i] for _, q in self._past], left=np.nan) for i in range(3)])


def _shape(frame: Frame) -> tuple[int, ...] | None:
    return None if frame.image is None else frame.image.shape


def teach(plant: Plant, frames: int = 30) -> Target:
    """Take what the camera sees from now on as the target: the mean over `frames` frames. It never moves anything."""
    require(frames >= 1, "frames", frames, "a whole number of at least 1 frames")
    plant.reset()
    points: list[Floats] = []
    joints: list[Floats] = []
    last, began = plant.read().frame, plant.clock.now()
    good = began
    for _ in ticks(plant.clock):
        seen = plant.read()
        if seen.frame > last and seen.exposure >= began and np.isfinite(seen.points).all():
            points.append(seen.points)
            joints.append(seen.q)
            good = seen.now
        last = max(last, seen.frame)
        if len(points) == frames:
            return Target(np.mean(points, axis=0), np.mean(joints, axis=0), began)
        if not seen.now - good <= TEACH_TIMEOUT * 1e9:
            break
    raise NotShown("the target cannot be taught: both markers must be in the picture while it is shown")


@dataclass(frozen=True, eq=False)
class Tick:
    """One round of the loop: time ns since its start, what was seen, what a person asked for, what was decided, and the
    joint rates (3,) that the arm took of it."""

    time: int
    seen: Observation
    request: Request
    state: State
    applied: Floats


Operator = Callable[[Tick], Request]
"""A person beside the loop, who sees every tick and asks for something at the next."""


def run(
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float = 30.0,
    done: Callable[[Tick], bool] = lambda tick: False,
    state: State | None = None,
    operator: Operator | None = None,
) -> Generator[Tick]:
    """Switch the drive on, servo to the target and yield every tick; to call it is a person's act.

    It begins from nothing, or goes on from the `state` of an earlier run, with what was learnt there. It ends after
    `duration` s, when `done` says so, with a fault, and, where no `operator` stands by to resume, with a pause. However
    it ends, by itself, by an error or by Ctrl-C, the last thing it does is to bring the arm to rest and switch it off.
    """
    servo.warm_up()
    plant.reset()
    state = servo.init() if state is None else servo.again(state)
    request = Request.NONE
    if state.phase is not Phase.FAULT:
        plant.enable()
    try:
        for time in ticks(plant.clock, servo.rate, duration):
            seen = plant.read()
            state = servo.step(state, seen, target, request)
            tick = Tick(time, seen, request, state, plant.send(state.command))
            yield tick
            if done(tick) or _over(state, operator):
                break
            request = Request.NONE if operator is None else operator(tick)
    finally:
        _rest(plant, servo, state.command)


def _over(state: State, operator: Operator | None) -> bool:
    """Whether nothing more will happen."""
    waits = (Phase.FAULT, Phase.PAUSED) if operator is None else ()
    return state.phase is Phase.DISABLED or (state.phase in waits and not state.command.rates.any())


def _rest(plant: Plant, servo: Servo, last: Command) -> None:
    """Ramp the joint rates to zero through the gate, from the next tick on, and switch the drive off."""
    try:
        plant.clock.wait_until(plant.clock.now() + servo.period)
        for _ in ticks(plant.clock, servo.rate):
            seen = plant.read()
            if not (last.enabled and last.rates.any() and seen.enabled):
                break
            last = servo.gate.admit(np.zeros(3), last, seen.q, servo.mechanism.limits, seen.now, 0.0).command
            plant.send(last)
    finally:
        plant.send(servo.gate.stop(last, plant.clock.now()))
