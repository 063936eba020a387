"""One regulation experiment of the paper, for either estimator: from initial errors of exactly
[40°, 80 px, 60 px].

The tool explores from nothing, goes back to the start at the paper's gains, and on to the target
that it was shown. A run is faithful only if Ĵ is within 30 % of J after exploration and r falls by
k b = 1 px/s ± 30 % while saturated: a small Ĵ multiplies k, and its quick success is not the
paper's.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.lab.closed_loop import (
    NOISE,
    PAPER_SCENES,
    PRINTED_FIT,
    PRINTED_LAW,
    WIDE,
    Arrived,
    ClosedLoop,
    recorded,
    servo_for,
)
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.statistics import rms
from rcmservo.experiments.harness.tasks import Task
from rcmservo.figures import plots
from rcmservo.guard.causes import Cause
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.exploration import Exploration
from rcmservo.record.reader import Record
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings, SceneSettings

PERCENT = 0.02
"""Share of its initial value below which an error is gone."""

ACCURATE = 0.3
"""Scaled ‖Ĵ − J‖/‖J‖ of a faithful run."""

SLOPE = 0.3
"""px/s by which the slope of r may be off 1 px/s in a faithful run."""

AT_REST = 2.0
"""s at the end over which the remaining error is taken."""

SEEN = 0.1
"""s after which the servo has seen its new target's error, and the tool has hardly moved."""

SMOOTH = 60
"""Frames, one second, over which a flow is averaged to tell signal from noise."""


@dataclass(frozen=True)
class Regulation:
    """What both regulation experiments share."""

    seeds: tuple[int, ...] = tuple(range(12))
    """Of the scenes, one run in each."""
    shown: int = 0
    """Seed of the figures."""
    scene: SceneSettings = PAPER_SCENES
    """Its errors are those at the start."""
    estimator: Estimator = PRINTED_FIT
    """What Ĵ comes from."""
    exploration: Exploration = WIDE
    """The first motion, as this estimator needs it."""
    half_way: bool = False
    """Whether it explores where half of the errors are left."""
    controller: SaturatedController = PRINTED_LAW
    """The law of the way back to the start, and of that to the target."""
    lines: int = 50
    """H."""
    back: float = 150.0
    """s allowed for the way back to the start."""
    duration: float = 110.0
    """s from the start on."""
    pictures: bool = True
    """Whether frames are rendered; if not, the camera tells points."""
    noise: float = NOISE
    """px where there are no pictures."""

    def rig(self) -> RigSettings:
        """The laboratories that the seeds draw from."""
        return RigSettings(scene=self.scene, point_noise=self.noise)

    def servo(self, rig: Rig) -> Servo:
        """The servo of such a run."""
        return servo_for(
            rig.settings, self.estimator, self.exploration, self.controller, self.lines
        )

    @property
    def errors(self) -> Floats:
        """|Δy| (3,) rad, px, px at the start."""
        return np.abs(np.array(self.scene.errors, dtype=float))


@dataclass(frozen=True)
class Regulated:
    """What a run that left its start measured, from its record."""

    began: float
    """s at which it left its start."""
    explored_at: float
    """s."""
    explored: float
    """Scaled error of Ĵ after exploration."""
    at_start: float
    """The same when it left its start."""
    at_end: float
    """The same at the end."""
    initial: JsonFloats
    """|Δy| (3,) at the start, as the servo measures it."""
    slopes: JsonFloats
    """Fall (3,) of the errors while saturated, °/s, px/s, px/s; NaN of one that never was."""
    left: JsonFloats
    """Share (3,) of the initial errors at the end."""
    time_to_small: float | None
    """s from the start until all errors are below 2 %."""
    pose: float
    """‖p₂ − p_d‖ mm over the last second."""
    model: float | None
    """rms px between π (34) and m₁ from the start on; None without a model."""
    flow_away: float
    """rms of ω (35) − ẏ, means over a second, as a share of ẏ's."""
    flow_noise: float
    """Change of ω from frame to frame as a share of that of ẏ."""

    @property
    def faithful(self) -> bool:
        """Whether the run is the paper's: Ĵ near J, and the speed that the gains ask for."""
        return bool(self.explored <= ACCURATE and abs(self.slopes[1] - 1.0) <= SLOPE)


@dataclass(frozen=True)
class RegulationRun:
    """One regulation, as it ended."""

    cause: str
    """What held the tool still at the last tick, in words; empty if nothing did."""
    regulated: Regulated | None
    """What was measured; None where it failed to explore."""

    @property
    def small(self) -> bool:
        """Whether every error fell below 2 % of its initial value and the servo did not stop."""
        one = self.regulated
        return one is not None and not self.cause and float(np.max(one.left)) < PERCENT

    @property
    def succeeded(self) -> bool:
        """Whether it did so in a faithful run."""
        return self.small and self.regulated is not None and self.regulated.faithful

    @property
    def why_not(self) -> str:
        """In words, why it does not count."""
        one = self.regulated
        if one is None or self.cause:
            return self.cause
        if one.explored > ACCURATE:
            return f"Ĵ off by {one.explored:.0%} after exploration"
        if abs(one.slopes[1] - 1.0) > SLOPE:
            return f"r fell by {one.slopes[1]:.2f} px/s"
        return f"{np.max(one.left):.1%} of an error left"


def begun(runs: Iterable[RegulationRun]) -> list[Regulated]:
    """The runs that left their start."""
    return [run.regulated for run in runs if run.regulated is not None]


def regulation_tasks(settings: Regulation, prefix: str = "seed") -> list[Task]:
    """One closed loop for every seed."""
    cost = (0.35 if settings.pictures else 0.03) * (settings.duration + 80.0)
    return [
        Task(f"{prefix}-{seed}", partial(regulate, seed=seed, settings=settings), cost)
        for seed in settings.seeds
    ]


def regulate(folder: Path, seed: int, settings: Regulation) -> RegulationRun:
    """Explore, go back to the start, regulate; what was measured, from the record."""
    with ClosedLoop(folder, seed, settings.rig(), settings.pictures, settings.servo) as loop:
        scene = loop.rig.scene
        home, _ = loop.shown(scene.start)
        target, p_d = loop.shown(scene.target)
        loop.rig.place(scene.half_way if settings.half_way else scene.start)
        tick = loop.explore(home)
        if not tick.state.explored:
            return RegulationRun(tick.state.cause.stopping or Cause.NOT_EXPLORED.value, None)
        tick = loop.last(home, settings.back, tick.state, done=Arrived())
        began = loop.elapsed()
        for count, there in enumerate(loop.stage(target, settings.duration, tick.state)):
            tick = there
            if count == round(100 * SEEN):
                loop.snapshot("initial.png", target, tick.state, _words("initial", tick))
        loop.snapshot("final.png", target, tick.state, _words("final", tick))
    return RegulationRun(
        tick.state.cause.stopping, measured(recorded(folder), began, p_d, settings)
    )


def _words(when: str, tick: Tick) -> str:
    s, r, d = np.abs(tick.state.delta) * plots.DEGREES
    return f"{when}: |ds| {s:.2f} deg  |dr| {r:.2f} px  |dd| {d:.2f} px"


def measured(rows: Record, began: float, p_d: Floats, settings: Regulation) -> Regulated:
    """The numbers of a run, from its record."""
    error = rows.truth["jacobian_error"][:, 0]
    judged = np.flatnonzero(np.isfinite(error))
    explored = int(np.argmax([phase not in ("IDLE", "ACQUIRE") for phase in rows.phase]))
    new = rows.new_frames(began + SEEN)
    sizes, time = np.abs(rows.ticks["delta"][new]), rows.time[new] - began
    small = (sizes < PERCENT * settings.errors).all(axis=1)
    pose = np.linalg.norm(rows.truth["p2"] - p_d, axis=1)
    away, noise = _flows(rows, began + SEEN)
    return Regulated(
        began=began,
        explored_at=float(rows.time[explored]),
        explored=float(error[explored]),
        at_start=float(error[judged[rows.time[judged] >= began][0]]),
        at_end=float(error[judged[-1]]),
        initial=np.mean(sizes[:6], axis=0),
        slopes=_slopes(time, sizes, settings),
        left=np.sqrt(np.mean(sizes[time > time[-1] - AT_REST] ** 2, axis=0)) / settings.errors,
        time_to_small=float(time[np.argmax(small)]) if small.any() else None,
        pose=rms(pose[rows.time > rows.time[-1] - 1.0]),
        model=_model_distance(rows, began),
        flow_away=away,
        flow_noise=noise,
    )


def _slopes(time: Floats, sizes: Floats, settings: Regulation) -> Floats:
    """Fall (3,) of every error in units/s while it is saturated."""
    sizes, bounds = sizes * plots.DEGREES, np.array(settings.controller.bounds) * plots.DEGREES
    return np.array([slope(time, sizes[:, i], bounds[i]) for i in range(3)])


def slope(time: Floats, size: Floats, bound: float) -> float:
    """Fall of an error in units/s while it is saturated, above 1.2 b, by least squares; NaN of one
    that never was."""
    saturated = size > 1.2 * bound
    if saturated.sum() < 10:
        return float("nan")
    return float(-np.polyfit(time[saturated], size[saturated], 1)[0])


def _model_distance(rows: Record, began: float) -> float | None:
    """rms px between π and m₁ from the start on."""
    new = rows.new_frames(began)
    away = rows.ticks["model"][new, :2] - (rows.ticks["points"][new, :2] - rows.ticks["o_c"][new])
    return rms(np.linalg.norm(away, axis=1)) if np.isfinite(away).all() else None


def _flows(rows: Record, since: float) -> tuple[float, float]:
    """How far ω is from ẏ in means over a second, and its noise, both as shares of ẏ's."""
    y_dot, omega = (flow * plots.DEGREES for flow in plots.flows(rows, rows.new_frames(since)))
    known = np.isfinite(y_dot).all(axis=1) & np.isfinite(omega).all(axis=1)
    y_dot, omega = y_dot[known], omega[known]  # a pause at the end has forgotten the estimate
    mean = moving_means(y_dot)
    return (
        rms(moving_means(omega) - mean) / rms(mean),
        rms(np.diff(omega, axis=0)) / rms(np.diff(y_dot, axis=0)),
    )


def moving_means(flow: Floats) -> Floats:
    """Moving means over SMOOTH frames of a flow (n, 3)."""
    window = np.ones(SMOOTH) / SMOOTH
    return np.stack([np.convolve(column, window, mode="valid") for column in flow.T], axis=1)
