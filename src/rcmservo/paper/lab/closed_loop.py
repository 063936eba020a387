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
from typing import Any

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.control.saturated_controller import SaturatedController
from rcmservo.estimation.base import Estimator
from rcmservo.estimation.flow_rule import FlowEstimator
from rcmservo.estimation.projection_rule import PAPER_PROJECTION_ESTIMATOR, ProjectionEstimator
from rcmservo.figures.overlay import draw_overlay, write_image
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.recording import reader
from rcmservo.recording.reader import RECORD
from rcmservo.recording.writer import Recorder
from rcmservo.safety.gate import Gate
from rcmservo.servo.servo import Servo, State
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import ColourMarkers, PointMarkers

TEACHING_FRAMES = 30
"""Frames over which a taught target is averaged; the numbers of the claims depend on it."""

PRINTED_LAW = SaturatedController(gain=0.1, bounds=(float(np.radians(10.0)), 10.0, 10.0))
"""The paper's law with k = 0.1 and b = (10°, 10 px, 10 px)."""

FAST_LAW = SaturatedController(gain=2.0)
"""The paper's law with k = 2 and the default b."""

FAST_FIT = ProjectionEstimator()
"""The paper's projection-based estimator with the fast Γ, on both markers."""

EQUAL_ROUNDS = Exploration(leg_time=1.0, speed_scale=0.12, growth=1.0, max_time=60.0)
"""Exploration in equal rounds at about 30 mm/s with `FAST_ARM`; `reach` alone sets their size."""

PROJECTION_EXPLORATION = replace(EQUAL_ROUNDS, max_leg_length=17.0, min_corners=8)
"""Exploration for the printed fit: ten noisy observations of one marker need two rounds of 17
mm."""

PAPER_SCENES = SceneSettings(
    errors=(float(np.radians(40.0)), -80.0, -60.0),
    insertion=(40.0, 70.0),
    distance=(150.0, 400.0),
    room=17.0,
)
"""Scenes of the regulation experiments, with initial errors of exactly [40°, 80 px, 60 px].

r and d grow on the path to the target. The insertion is short and the camera far, so that the
imaged tool can rotate by 40° within the image.
"""

FLOW_ESTIMATOR = FlowEstimator(gamma=0.001)
"""The paper's flow-based estimator."""

FLOW_EXPLORATION = replace(EQUAL_ROUNDS, max_leg_length=12.0, min_corners=60, tolerance=0.2)
"""Exploration for the flow rule, which converges as 1 − exp(−γ v L): about 20 s of motion."""

PAPER_METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (PAPER_PROJECTION_ESTIMATOR, PROJECTION_EXPLORATION),
    "flow": (FLOW_ESTIMATOR, FLOW_EXPLORATION),
}
"""The paper's estimators, each with its exploration."""

FAST_ARM = Gate(speed=(2.0, 2.0, 160.0), slew=(20.0, 20.0, 1600.0))
"""Limits of a fast arm: an exploration at 30 mm/s uses no more than its permitted fraction of the
speed."""

POINT_NOISE_PX = 0.1
"""Standard deviation (px) of the markers of a camera without images, about that of tracking in
rendered frames."""

ARRIVED = np.array([np.radians(0.1), 0.2, 0.2])
"""Largest mean |Δy| (rad, px, px) over `AVERAGED_FRAMES` at which the tool has arrived."""

AVERAGED_FRAMES = 30


def remove_limits(exploration: Exploration) -> Exploration:
    """Return the same exploration without a limit on legs and time."""
    return replace(exploration, min_corners=1000, max_time=1e6)


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
    controller: SaturatedController = PRINTED_LAW,
) -> Servo:
    """Return a servo with the mechanism and the tool of the laboratory; the camera is unknown."""
    return Servo(
        laboratory.mechanism,
        laboratory.tool,
        estimator=estimator,
        controller=controller,
        exploration=exploration or Exploration(),
        imaged_rcm=ImagedRcm(lines=50),
        gate=FAST_ARM,
    )


@contextmanager
def closed_loop(
    folder: Path, seed: int, settings: RigSettings, pictures: bool, servo: Servo
) -> Generator["ClosedLoop"]:
    """Open a closed loop and its record, with rendered images or with a camera of points."""
    about = {
        "simulation": True,
        "seed": seed,
        "pictures": pictures,
        "rig": asdict(settings),
        "servo": repr(servo),
    }
    servo.warm_up()
    rig = Rig(seed, settings, pictures=pictures)
    tracker = ColourMarkers() if pictures else PointMarkers()
    plant = Plant(rig.arm, rig.camera, tracker, rig.clock)
    with Recorder(folder / RECORD, about) as recorder:
        yield ClosedLoop(folder, rig, plant, servo, recorder)


class ClosedLoop:
    """Rig and plant, with a record of each tick of each stage."""

    def __init__(
        self, folder: Path, rig: Rig, plant: Plant, servo: Servo, recorder: Recorder
    ) -> None:
        self.folder, self.rig, self.plant, self.servo = folder, rig, plant, servo
        self._recorder = recorder
        self._began: int | None = None

    def teach(self, q: Floats) -> tuple[Target, Floats]:
        """Return the target taught at the joints `q` (3,), and p_d (3,) in mm of marker 2."""
        self.rig.place(q)
        return teach(self.plant, TEACHING_FRAMES), self.true_p2()

    def elapsed(self) -> float:
        """Return the time (s) since the start of the first stage."""
        return 0.0 if self._began is None else (self.rig.clock.now() - self._began) / 1e9

    def true_p2(self) -> Floats:
        """Return the true position (3,) of marker 2 in mm."""
        return self.rig.truth.markers(self.rig.clock.now())[1]

    def stage(
        self,
        target: Target,
        duration: float,
        state: State | None = None,
        done: Callable[[Tick], bool] = lambda tick: False,
    ) -> Iterator[Tick]:
        """Servo to the target like `run`, and record; the time continues from stage to stage."""
        now = self.rig.clock.now()
        self._began = now if self._began is None else self._began
        self._recorder.begin(self.servo, target, state)
        for tick in run(self.plant, self.servo, target, duration, done=done, state=state):
            shifted = replace(tick, time=tick.time + now - self._began)
            self.rig.truth.write(self._recorder, shifted)
            yield shifted

    def last(self, *arguments: Any, **options: Any) -> Tick:
        """Run a stage to its end and return its last tick."""
        *_, tick = self.stage(*arguments, **options)
        return tick

    def explore(self, target: Target) -> Tick:
        """Explore until the servo succeeds or its time limit ends; return the last tick."""

        def explored(tick: Tick) -> bool:
            return tick.state.explored

        return self.last(target, self.servo.exploration.max_time + 1.0, done=explored)

    def snapshot(
        self, name: str, target: Target, state: State, words: str, others: Sequence[Target] = ()
    ) -> None:
        """Write the newest image with the features in blue and the target in black."""
        frame = self.plant.camera.latest()
        if frame is None or frame.image is None or self.plant.markers is None:
            return
        points = self.plant.markers.points
        picture = draw_overlay(
            frame.image, points, state.o_c, target.points, words, [other.points for other in others]
        )
        write_image(self.folder / name, picture)


class Arrived:
    """Condition that the mean error over the newest frames is within `ARRIVED`."""

    def __init__(self) -> None:
        self._errors: deque[Floats] = deque(maxlen=AVERAGED_FRAMES)
        self._frame = -1

    def __call__(self, tick: Tick) -> bool:
        if tick.state.newest_frame > self._frame:
            self._errors.append(tick.state.delta)
            self._frame = tick.state.newest_frame
        full = len(self._errors) == AVERAGED_FRAMES
        return full and bool((np.abs(np.mean(self._errors, axis=0)) < ARRIVED).all())
