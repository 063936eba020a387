"""The only code that makes anything move: the plant put together, a target taught, and the loop run.

    plant.read() ─► servo.step() ─► plant.send()

on every tick of the plant's own clock.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rcmservo.clock import ticks
from rcmservo.errors import RcmServoError, require
from rcmservo.plant import Camera, Clock, Command, Floats, Markers, Mechanism, Observation, Target, Tracker
from rcmservo.servo import Phase, Servo, State

TEACH_TIMEOUT = 2.0
JOINT_HISTORY = 256


class NotShown(RcmServoError):
    """A target that could not be taught, because the camera did not see both markers."""


class Plant:
    """A mechanism, a camera and a tracker as one thing that is read and sent to.

    It keeps the joints' recent past, to tell where they were when a frame was exposed.
    """

    def __init__(self, mechanism: Mechanism, camera: Camera, tracker: Tracker, clock: Clock) -> None:
        self.mechanism, self.camera, self.tracker, self.clock = mechanism, camera, tracker, clock
        self.markers: Markers | None = None
        self._past: deque[tuple[int, Floats]] = deque(maxlen=JOINT_HISTORY)
        self._frame = -1
        self._exposure = 0
        self._q_exposure = np.full(3, np.nan)

    def read(self) -> Observation:
        """Measure the joints, and track the markers where a new frame has arrived."""
        time, q = self.mechanism.measure()
        self._past.append((time, q))
        frame = self.camera.latest()
        if frame is not None and frame.number > self._frame:
            self.markers = self.tracker.find(frame)
            self._frame, self._exposure = frame.number, frame.exposure
            self._q_exposure = self._joints_at(frame.exposure)
        points = self.markers.points if self.markers is not None else np.full((2, 2), np.nan)
        return Observation(self.clock.now(), q, self._frame, self._exposure, self._q_exposure, points)

    def reset(self) -> None:
        """Forget where markers and joints were: a person may have moved the tool since they were last read."""
        self.tracker.reset()
        self._past.clear()

    def send(self, command: Command) -> Floats:
        """Pass a command on to the arm; the joint rates (3,) that the arm took."""
        return self.mechanism.apply(command)

    def _joints_at(self, time: int) -> Floats:
        times = [t for t, _ in self._past]
        return np.array([np.interp(time, times, [q[i] for _, q in self._past]) for i in range(3)])


def teach(plant: Plant, frames: int = 30) -> Target:
    """Take what the camera sees now as the target: the mean over `frames` new frames. It never moves anything."""
    require(frames >= 1, "frames", frames, "a whole number of at least 1 frames")
    plant.reset()
    points: list[Floats] = []
    joints: list[Floats] = []
    last = plant.read().frame
    for _ in ticks(plant.clock, duration=TEACH_TIMEOUT + frames / 10.0):
        seen = plant.read()
        if seen.frame > last and np.isfinite(seen.points).all():
            points.append(seen.points)
            joints.append(seen.q)
        last = max(last, seen.frame)
        if len(points) == frames:
            return Target(np.mean(points, axis=0), np.mean(joints, axis=0))
    raise NotShown("the target cannot be taught: both markers must be in the picture while it is shown")


@dataclass(frozen=True, eq=False)
class Tick:
    """One round of the loop: time ns since its start, what was seen, what was decided, what the arm took of it."""

    time: int
    seen: Observation
    state: State
    applied: Floats


def run(
    plant: Plant,
    servo: Servo,
    target: Target,
    duration: float = 30.0,
    rate: float = 100.0,
    done: Callable[[Tick], bool] = lambda tick: False,
    state: State | None = None,
) -> Iterator[Tick]:
    """Servo to the target and yield every tick; stop when the servo pauses and its command is zero, or `done` says so.

    It begins from nothing, or goes on from the `state` of an earlier run, with what was learnt there.
    However it ends, by itself, by an error or by Ctrl-C, the last thing it does is to bring the arm to rest.
    """
    plant.reset()
    state = servo.init() if state is None else state.but(command=servo.gate.rest())
    try:
        for time in ticks(plant.clock, rate, duration):
            seen = plant.read()
            state = servo.step(state, seen, target)
            tick = Tick(time, seen, state, plant.send(state.command))
            yield tick
            if done(tick) or (state.phase is Phase.PAUSED and not state.command.rates.any()):
                break
    finally:
        _rest(plant, servo, state.command, rate)


def _rest(plant: Plant, servo: Servo, last: Command, rate: float) -> None:
    """Ramp the joint rates to zero through the gate, from the next tick on."""
    plant.clock.wait_until(plant.clock.now() + round(1e9 / rate))
    for _ in ticks(plant.clock, rate):
        seen = plant.read()
        last = servo.gate.admit(np.zeros(3), last, seen.q, servo.mechanism.limits, seen.now).command
        plant.send(last)
        if not last.rates.any():
            break
