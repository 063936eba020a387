"""What the conclusions claim in passing: the camera may be relocated, here moved and rolled in the
middle of a run.

The servo must notice and stop. Then a person shows the target in the new view and puts the tool
back to where it was, and the servo explores anew and goes on. (The script plays the person.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.closed_loop import (
    FAST_FIT,
    FAST_LAW,
    FLOW,
    LONG,
    NOISE,
    ClosedLoop,
    recorded,
    servo_for,
)
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import median, share
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.causes import Cause
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Target
from rcmservo.loop.run import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import SCALE
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings, SceneSettings

PAPER = 4.0
STOPS = 0.25
"""s within which the tool must stand still: 3 frames to notice, and the ramp from full speed."""

METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (FAST_FIT, Exploration()),
    "flow": (FLOW, LONG),
}


@dataclass(frozen=True)
class Settings:
    """Runs in which the camera is relocated on the way."""

    seeds: Sequence[int] = (0, 1, 2)
    """Of the scenes, one run with each estimator in each."""
    share: float = 0.5
    """Of the way in Δy that is left when the camera is relocated."""
    duration: float = 50.0
    """s of each part."""
    controller: SaturatedController = FAST_LAW
    """Of both estimators."""
    scene: SceneSettings = field(
        default_factory=lambda: SceneSettings(room=12.0, travel=(30.0, 60.0))
    )
    """What the scenes are drawn from."""
    pictures: bool = True
    """Whether frames are rendered; if not, the camera tells points."""
    noise: float = NOISE
    """px where there are no pictures."""


@dataclass(frozen=True)
class Stop:
    """What the servo did when the camera was moved."""

    moved: float | None
    """s at which it was moved; None if the servo never came so far."""
    stopped_after: float | None
    """s until the tool stood still; None if it did not."""
    travelled: float
    """mm of marker 2 from then to the end."""
    noticed: bool
    """Whether the servo paused for that reason."""


@dataclass(frozen=True)
class Relocation:
    """One run in which the camera was relocated."""

    stop: Stop
    """What the servo did when the camera was moved."""
    again: float
    """s at which the servo was started again."""
    end_cause: str
    """What held the tool still at the last tick, in words; empty if nothing did."""
    pose_error: float
    """mm."""


def tasks(settings: Settings) -> list[Task]:
    cost = (0.35 if settings.pictures else 0.05) * 2.0 * settings.duration
    return [
        Task(
            f"{method}-{seed}",
            partial(relocated, seed=seed, method=method, settings=settings),
            cost,
        )
        for method in METHODS
        for seed in settings.seeds
    ]


def relocated(folder: Path, seed: int, method: str, settings: Settings) -> Relocation:
    """Servo, relocate the camera half-way, see the tool stop, show the target anew, and go on from
    nothing."""
    laboratory = RigSettings(scene=settings.scene, point_noise=settings.noise)
    estimator, exploration = METHODS[method]

    def servo(rig: Rig) -> Servo:
        return servo_for(rig.settings, estimator, exploration, settings.controller)

    with ClosedLoop(folder, seed, laboratory, settings.pictures, servo) as loop:
        target, p_d = loop.shown(loop.rig.scene.target)
        loop.rig.go_home()
        stop = _until_stopped(loop, target, settings)
        stopped_at = loop.rig.arm.q_true
        target, _ = loop.shown(loop.rig.scene.target)
        loop.rig.place(stopped_at)
        again = loop.elapsed()
        tick = loop.last(target, settings.duration)
        words = "after: the target was shown in the new view"
        loop.snapshot("after.png", target, tick.state, words)
        error = float(np.linalg.norm(loop.true_p2() - p_d))
    return Relocation(stop, again, tick.state.cause.stopping, error)


def _until_stopped(loop: ClosedLoop, target: Target, settings: Settings) -> Stop:
    """Servo to the target, move the camera on the way, and see when and why the tool stands
    still."""
    way = HalfWay(settings.share)
    moved, stopped, p2 = None, None, loop.true_p2()
    tick: Tick | None = None
    for tick in loop.stage(target, settings.duration):
        if moved is None and way.reached(tick):
            loop.snapshot("before.png", target, tick.state, "before")
            loop.rig.relocate_camera()
            moved, p2 = tick.time / 1e9, loop.true_p2()
        elif moved is not None and stopped is None and not tick.state.command.rates.any():
            stopped = tick.time / 1e9
    assert tick is not None
    words = "the camera was moved and rolled: " + tick.state.phase.value
    loop.snapshot("moved.png", target, tick.state, words)
    return Stop(
        moved=moved,
        stopped_after=None if moved is None or stopped is None else stopped - moved,
        travelled=float(np.linalg.norm(loop.true_p2() - p2)),
        noticed=tick.state.cause is Cause.CAMERA_MOVED,
    )


class HalfWay:
    """Whether no more than a share of the first error is left."""

    def __init__(self, share: float) -> None:
        self._share, self._first = share, np.nan

    def reached(self, tick: Tick) -> bool:
        if tick.state.phase is not Phase.SERVO:
            return False
        size = float(np.linalg.norm(tick.state.delta / SCALE))
        self._first = size if np.isnan(self._first) else self._first
        return size < self._share * self._first


@dataclass(frozen=True)
class Relocations:
    """All runs."""

    settings: Settings
    """What the runs were made with."""
    runs: dict[str, Relocation]
    """By the tasks' names, which tell estimator and seed."""

    @property
    def stops(self) -> list[Stop]:
        return [run.stop for run in self.runs.values()]


def chapter(settings: Settings, results: Results) -> Chapter:
    names = [task.name for task in tasks(settings)]
    found = Relocations(settings, {name: results.of(Relocation, name) for name in names})
    claims = [gets_there(found), is_noticed(found), stands_still(found)]
    return Chapter(claims, _figures(settings, results))


def gets_there(found: Relocations) -> Claim:
    errors = [run.pose_error for run in found.runs.values()]
    failed = [
        f"{name}: {run.end_cause or 'not there'}"
        for name, run in found.runs.items()
        if run.pose_error > PAPER
    ]
    return Claim(
        "with the target shown in the new view the servo explores anew and gets there: largest "
        "pose error",
        "relocate",
        max(errors),
        "mm",
        "<=",
        PAPER,
        found.settings.seeds,
        remark="a target that was registered in the old view is lost with it and must be shown "
        "again",
        detail="; ".join([f"median {median(errors):.2f} mm", *failed]),
        figure="relocated",
    )


def is_noticed(found: Relocations) -> Claim:
    return Claim(
        "a camera that is moved and rolled in mid-run is noticed, and the servo pauses for that "
        "reason",
        OURS,
        100.0 * share(stop.noticed for stop in found.stops),
        "% of runs",
        ">=",
        100.0,
        found.settings.seeds,
        detail=f"{len(found.stops)} runs, both estimators, k = {found.settings.controller.gain:g}",
        figure="relocated",
    )


def stands_still(found: Relocations) -> Claim:
    soon = [stop.stopped_after is not None and stop.stopped_after <= STOPS for stop in found.stops]
    after = [f"{stop.stopped_after:.2f}" for stop in found.stops if stop.stopped_after is not None]
    return Claim(
        f"the tool stands still within {STOPS:g} s after the camera was moved",
        OURS,
        100.0 * share(soon),
        "% of runs",
        ">=",
        100.0,
        found.settings.seeds,
        detail=f"after {', '.join(after)} s; it went on by "
        f"{max(stop.travelled for stop in found.stops):.1f} mm at most",
        figure="relocated",
    )


def _figures(settings: Settings, results: Results) -> list[Shown]:
    seed = settings.seeds[0]
    figure = Figure(
        "The camera relocated in mid-run",
        [_over_time(method, f"{method}-{seed}", results) for method in METHODS],
    )
    caption = (
        "The feature error as the servo knows it. Shaded: the camera was moved, the servo has "
        "stopped, and the person shows the target anew; then it explores and goes on."
    )
    return [*_pictures(seed, results), Shown("relocated", "V", caption, [seed], figure)]


def _pictures(seed: int, results: Results) -> list[Shown]:
    folder = results.folder(f"projection-{seed}")
    pictures = [folder / f"{name}.png" for name in ("before", "moved", "after")]
    if not all(path.exists() for path in pictures):
        return []
    caption = (
        "Before the camera was moved, after it (the old target is meaningless now), and at the end."
    )
    return [Shown("pictures", "V", caption, [seed], pictures=pictures)]


def _over_time(method: str, task: str, results: Results) -> Panel:
    rows, run = recorded(results.folder(task)), results.of(Relocation, task)
    new = rows.new_frames()
    size = np.linalg.norm(rows.ticks["delta"][new] / SCALE, axis=1)
    label = f"scaled $|\\Delta y|$\n{method}"
    moved = run.stop.moved
    spans = [(moved, run.again)] if moved is not None else []
    return Panel("time [s]", label, [curve("", rows.time[new], size)], shaded=spans, log_y=True)


EXPERIMENT = Experiment(
    name="relocation",
    title="The camera relocated",
    about="“to arbitrarily relocate the camera to observe different regions of interest” (V): "
    "the camera is moved and rolled in the middle of a run.",
    whole=Settings(),
    quick=Settings(seeds=(0,), pictures=False),
    tasks=tasks,
    chapter=chapter,
)
