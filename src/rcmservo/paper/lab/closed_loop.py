"""Simulated closed loop in stages, with one record that also contains the true state.

The experiment acts as the operator: it places the tool, teaches targets, moves the camera, and
starts the servo.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.figures.overlay import draw_overlay, write_image
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.paper_settings import FAST_ARM, PAPER_CONTROLLER, TEACHING_FRAMES
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD
from rcmservo.recording.writer import Recorder
from rcmservo.servo.servo import Servo, State
from rcmservo.sim import Rig, RigSettings
from rcmservo.tracking import ColourMarkers, PointMarkers

MAX_MEAN_ERROR = np.array([np.radians(0.1), 0.2, 0.2])
"""Largest mean |Δy| (rad, px, px) over `AVERAGED_FRAMES` at which the tool has arrived."""

AVERAGED_FRAMES = 30
"""Newest frames over which `Arrived` averages Δy."""


def read_task_record(folder: Path) -> reader.Record:
    """Return the record of a task's closed loop."""
    path = folder / RECORD
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read(path: Path, changed: int) -> reader.Record:
    """Return a record; the modification time `changed` (ns) is a key of the cache only."""
    del changed
    return reader.read_record(path)


def make_servo(
    laboratory: RigSettings,
    estimator: Estimator,
    exploration: Exploration | None = None,
    controller: SaturatedController = PAPER_CONTROLLER,
) -> Servo:
    """Return a servo with the mechanism and the tool of the laboratory; the camera is unknown."""
    return Servo(
        laboratory.mechanism,
        laboratory.tool,
        estimator=estimator,
        controller=controller,
        exploration=exploration or Exploration(),
        gate=FAST_ARM,
    )


@contextmanager
def closed_loop(
    folder: Path, seed: int, settings: RigSettings, pictures: bool, servo: Servo
) -> Generator["ClosedLoop"]:
    """Open a closed loop and its record, with rendered images or with a camera of points."""
    about = dict[str, object](
        simulation=True, seed=seed, pictures=pictures, rig=asdict(settings), servo=repr(servo)
    )
    servo.warm_up()
    rig = Rig(seed, settings, pictures=pictures)
    tracker = ColourMarkers() if pictures else PointMarkers()
    plant = Plant(rig.arm, rig.camera, tracker, rig.clock)
    with Recorder(folder / RECORD, about) as recorder:
        yield ClosedLoop(folder, rig, plant, servo, recorder)


Condition = Callable[[Tick], bool]
"""Condition that ends a stage."""


def never(tick: Tick) -> bool:
    return False


class ClosedLoop:
    """Rig and plant, with a record of each tick of each stage."""

    def __init__(
        self, folder: Path, rig: Rig, plant: Plant, servo: Servo, recorder: Recorder
    ) -> None:
        self.folder, self.rig, self.plant, self.servo = folder, rig, plant, servo
        self._recorder = recorder
        self._start: int | None = None

    def teach(self, q: Floats) -> tuple[Target, Floats]:
        """Return the target taught at the joints `q` (3,), and p_d (3,) in mm of marker 2."""
        self.rig.place(q)
        return teach(self.plant, TEACHING_FRAMES), self.true_p2()

    def elapsed(self) -> float:
        """Return the time (s) since the start of the first stage."""
        return 0.0 if self._start is None else (self.rig.clock.now() - self._start) / 1e9

    def true_p2(self) -> Floats:
        """Return the true position (3,) of marker 2 in mm."""
        return self.rig.truth.markers(self.rig.clock.now())[1]

    def run_stage(
        self, target: Target, duration: float, state: State | None = None, done: Condition = never
    ) -> Iterator[Tick]:
        """Servo to the target like `run`, and record; the time continues from stage to stage."""
        now = self.rig.clock.now()
        self._start = now if self._start is None else self._start
        self._recorder.begin(self.servo, target, state)
        for tick in servo_ticks(self.plant, self.servo, target, duration, until=done, state=state):
            shifted = replace(tick, time=tick.time + now - self._start)
            self.rig.truth.record_tick(self._recorder, shifted)
            yield shifted

    def finish_stage(
        self, target: Target, duration: float, state: State | None = None, done: Condition = never
    ) -> Tick:
        """Run a stage to its end and return its last tick."""
        *_, tick = self.run_stage(target, duration, state, done)
        return tick

    def explore(self, target: Target) -> Tick:
        """Explore until the servo succeeds or its time limit ends; return the last tick."""
        duration = self.servo.exploration.max_time + 1.0
        return self.finish_stage(target, duration, done=lambda tick: tick.state.explored)

    def write_snapshot(
        self, name: str, target: Target, state: State, caption: str, others: Sequence[Target] = ()
    ) -> None:
        """Write the newest image with the features in blue and the target in black.

        `others` are further targets, also in black. A camera of points gives no image.
        """
        frame, markers = self.plant.camera.latest(), self.plant.markers
        if frame is not None and frame.image is not None and markers is not None:
            other_points = [other.points for other in others]
            features = (markers.points, state.o_c, target.points)
            picture = draw_overlay(frame.image, *features, caption, other_points)
            write_image(self.folder / name, picture)


class Arrived:
    """Condition that the mean error over the newest frames is within `MAX_MEAN_ERROR`."""

    def __init__(self) -> None:
        self._errors: deque[Floats] = deque(maxlen=AVERAGED_FRAMES)
        self._newest_frame = -1

    def __call__(self, tick: Tick) -> bool:
        """Return True if the tool has arrived."""
        if tick.state.newest_frame > self._newest_frame:
            self._errors.append(tick.state.delta)
            self._newest_frame = tick.state.newest_frame
        is_full = len(self._errors) == AVERAGED_FRAMES
        return is_full and bool((np.abs(np.mean(self._errors, axis=0)) < MAX_MEAN_ERROR).all())
