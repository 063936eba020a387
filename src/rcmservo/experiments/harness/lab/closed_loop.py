"""One simulated closed loop in stages, all in one record, with the truth beside it for the judge.

The script plays the person: it places the tool, shows targets, moves the camera, and starts the
servo.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from rcmservo.figures.overlay import draw, write_picture
from rcmservo.guard.gate import Gate
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.flow import FlowEstimator
from rcmservo.method.estimators.projection import PRINTED, ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.imaged_rcm import ImagedRcm
from rcmservo.record import reader
from rcmservo.record.reader import RECORD
from rcmservo.record.writer import Recorder
from rcmservo.servo.servo import Servo, State
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.tracking import ColourMarkers, PointMarkers

SHOWN = 30
"""Frames that the target of every experiment is the mean of: the claims' figures stand on it."""

PRINTED_LAW = SaturatedController(gain=0.1, bounds=(float(np.radians(10.0)), 10.0, 10.0))
"""The paper's k = 0.1 and b = (10°, 10 px, 10 px)."""

PRINTED_FIT = PRINTED
"""The paper's projection-based estimator."""

FAST_LAW = SaturatedController(gain=2.0)
"""The paper's law with k = 2 and our b."""

FAST_FIT = ProjectionEstimator()
"""The paper's projection-based estimator with our Γ, which is fast, on both markers."""

STEADY = Exploration(leg=1.0, share=0.12, growth=1.0, max_time=60.0)
"""A tour of equal rounds, whose size `reach` alone decides, at about 30 mm/s with FAST_ARM."""

WIDE = replace(STEADY, reach=17.0, legs=8)
"""An exploration for the printed fit: ten noisy observations of one marker need two rounds of 17
mm."""

PAPER_SCENES = SceneSettings(
    errors=(float(np.radians(40.0)), -80.0, -60.0),
    insertion=(40.0, 70.0),
    distance=(150.0, 400.0),
    room=17.0,
)
"""Scenes of the regulation experiments: initial errors of exactly [40°, 80 px, 60 px], r and d
growing to the target.

The insertion is short and the camera far, so that the imaged tool can turn by 40° inside the
picture.
"""

FLOW = FlowEstimator(gamma=0.001)
"""The paper's flow-based estimator."""

LONG = replace(STEADY, reach=12.0, legs=60, tolerance=0.2)
"""An exploration for the flow rule, which learns by 1 − exp(−γ v L): about 20 s of touring."""

PAPER_METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (PRINTED_FIT, WIDE),
    "flow": (FLOW, LONG),
}
"""The paper's estimators with the exploration that each needs."""

FAST_ARM = Gate(speed=(2.0, 2.0, 160.0), slew=(20.0, 20.0, 1600.0))
"""An arm so fast that exploring at 30 mm/s stays within the share of its speed that exploration may
use."""

NOISE = 0.1
"""px of noise of the camera without pictures, about what tracking rendered frames leaves."""

NEAR = np.array([np.radians(0.1), 0.2, 0.2])
"""Mean |Δy| (rad, px, px) over AVERAGED frames at which the tool counts as there."""

AVERAGED = 30


def for_ever(exploration: Exploration) -> Exploration:
    """The same tour, without an end."""
    return replace(exploration, legs=1000, max_time=1e6)


def recorded(folder: Path) -> reader.Record:
    """The record of a task's closed loop."""
    path = folder / RECORD
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read(path: Path, changed: int) -> reader.Record:
    """A record, kept for the next figure made of it, for as long as the file has not `changed`."""
    del changed
    return reader.read(path)


def servo_for(
    laboratory: RigSettings,
    estimator: Estimator,
    exploration: Exploration | None = None,
    controller: SaturatedController = PRINTED_LAW,
    lines: int = 50,
) -> Servo:
    """A servo that knows the laboratory's mechanism and tool, and nothing of its camera."""
    return Servo(
        laboratory.mechanism,
        laboratory.tool,
        estimator=estimator,
        controller=controller,
        exploration=exploration or Exploration(),
        imaged_rcm=ImagedRcm(lines=lines),
        gate=FAST_ARM,
    )


class ClosedLoop(AbstractContextManager["ClosedLoop"]):
    """A rig and its plant, and a record of every tick of every stage."""

    def __init__(
        self,
        folder: Path,
        seed: int,
        settings: RigSettings,
        pictures: bool,
        servo: Callable[[Rig], Servo],
    ) -> None:
        self.rig = Rig(seed, settings, pictures=pictures)
        tracker = ColourMarkers() if pictures else PointMarkers()
        self.plant = Plant(self.rig.arm, self.rig.camera, tracker, self.rig.clock)
        self.servo = servo(self.rig)
        self.servo.warm_up()
        self.folder = folder
        self._began: int | None = None
        about = {
            "simulation": True,
            "seed": seed,
            "pictures": pictures,
            "rig": asdict(settings),
            "servo": repr(self.servo),
        }
        self._recorder = Recorder(folder / RECORD, about)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._recorder.__exit__(kind, error, trace)

    def shown(self, q: Floats) -> tuple[Target, Floats]:
        """The target that a person shows at the joints q (3,), and where marker 2 then truly is,
        p_d (3,) mm."""
        self.rig.place(q)
        return teach(self.plant, SHOWN), self.true_p2()

    def elapsed(self) -> float:
        """s since the first stage began."""
        return 0.0 if self._began is None else (self.rig.clock.now() - self._began) / 1e9

    def true_p2(self) -> Floats:
        """Where marker 2 is now, (3,) mm."""
        return self.rig.truth.markers(self.rig.clock.now())[1]

    def stage(
        self,
        target: Target,
        duration: float,
        state: State | None = None,
        servo: Servo | None = None,
        done: Callable[[Tick], bool] = lambda tick: False,
    ) -> Iterator[Tick]:
        """Servo to the target as `run` does, and record; times go on from stage to stage."""
        now = self.rig.clock.now()
        self._began = now if self._began is None else self._began
        servo = servo or self.servo
        self._recorder.begin(servo, target, state)
        for tick in run(self.plant, servo, target, duration, done=done, state=state):
            there = replace(tick, time=tick.time + now - self._began)
            self._recorder.write(there)
            error = self.rig.truth.jacobian_error(
                tick.state.J_hat, tick.seen.q_exposure, tick.state.o_c
            )
            p1, p2 = self.rig.truth.markers(self.rig.clock.now())
            self._recorder.write_truth(p1, p2, error)
            yield there

    def last(self, *arguments: Any, **options: Any) -> Tick:
        """Run a stage to its end and give its last tick."""
        *_, tick = self.stage(*arguments, **options)
        return tick

    def explore(self, target: Target) -> Tick:
        """Explore from nothing, until Ĵ predicts or the servo gives up; the last tick."""

        def explored(tick: Tick) -> bool:
            return tick.state.explored

        return self.last(target, self.servo.exploration.max_time + 1.0, done=explored)

    def snapshot(
        self, name: str, target: Target, state: State, words: str, others: Sequence[Target] = ()
    ) -> None:
        """Write the camera's newest picture with features in blue and the target in black."""
        frame = self.plant.camera.latest()
        if frame is None or frame.image is None or self.plant.markers is None:
            return
        points = self.plant.markers.points
        picture = draw(
            frame.image, points, state.o_c, target.points, words, [other.points for other in others]
        )
        write_picture(self.folder / name, picture)


class Arrived:
    """Whether the tool is there: whether the mean error over the newest frames is small."""

    def __init__(self) -> None:
        self._errors: deque[Floats] = deque(maxlen=AVERAGED)
        self._frame = -1

    def __call__(self, tick: Tick) -> bool:
        if tick.state.frame > self._frame:
            self._errors.append(tick.state.delta)
            self._frame = tick.state.frame
        full = len(self._errors) == AVERAGED
        return full and bool((np.abs(np.mean(self._errors, axis=0)) < NEAR).all())
