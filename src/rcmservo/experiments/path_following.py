"""Following a path that is given as moving reference pixels, as in [10], with neither calibration
nor feed-forward.

Marker 1 is to go round a circle in space. The reference is the circle's picture in the true camera,
as [10] computes it by its forward model; the servo is told these pixels and nothing else. A law
without feed-forward stays behind by v/k.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import (
    Chapter,
    Claim,
    Experiment,
    Results,
    Shown,
    Task,
    median,
    rms,
)
from rcmservo.experiments.harness.closed_loop import servo_for
from rcmservo.experiments.harness.comparison import EVERY, FLOW_RULE, OURS, Learner, laboratory
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.guard.states import Cause, Phase
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.clock import ticks
from rcmservo.method.controller import SaturatedController
from rcmservo.method.features import SCALE
from rcmservo.servo.servo import State
from rcmservo.sim import Rig, SceneSettings

METHODS: Mapping[str, Learner] = {"ours": OURS, "flow": FLOW_RULE}

AT_START = 0.15
"""Scaled feature error at which the first point of a path counts as reached."""

NEAR_END = 0.2
"""s before the end of a path at which it counts as completed: two looks."""

LONGEST_LAG = 2.0
"""s up to which the lag behind a path is looked for."""


@dataclass(frozen=True)
class Settings:
    """A circle of ``radius`` mm about the target, gone round once in ``period`` s; ``noise`` px.

    ``approach`` s are allowed for the way to its first point, after the exploration.
    """

    seeds: tuple[int, ...] = tuple(range(10))
    scene: SceneSettings = field(default_factory=lambda: SceneSettings(room=17.0))
    noise: float = 0.3
    approach: float = 20.0
    controller: SaturatedController = field(default_factory=SaturatedController)
    radius: float = 10.0
    period: float = 30.0

    @property
    def speed(self) -> float:
        """v mm/s on the circle."""
        return 2.0 * np.pi * self.radius / self.period

    @property
    def lag(self) -> float:
        """v/k mm, by which a law without feed-forward stays behind."""
        return self.speed / self.controller.gain


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(method, follow_all, {"settings": settings, "method": method}, len(settings.seeds))
        for method in METHODS
    ]


def follow_all(folder: Path, settings: Settings, method: str) -> dict[str, Any]:
    """One estimator on the path of every scene."""
    del folder
    return {"trials": [follow(settings, METHODS[method], seed) for seed in settings.seeds]}


@dataclass(frozen=True, eq=False)
class Circle:
    """A path of marker 1 in the rig's space, oblique to the tool, so that it asks for yaw, pitch
    and insertion.

    ``middle`` (3,) mm is p₁ at the target; ``across`` and ``along`` (3,) mm are two radii at right
    angles.
    """

    rig: Rig
    middle: Floats
    across: Floats
    along: Floats
    period: float

    def p1(self, time: float) -> Floats:
        """Where marker 1 should be `time` s after the start, (3,) mm; before it, at the first
        point."""
        angle = 2.0 * np.pi * max(time, 0.0) / self.period
        return self.middle + np.cos(angle) * self.across + np.sin(angle) * self.along

    def reference(self, time: float) -> Target:
        """What the servo is to see `time` s after the start."""
        q = self.rig.settings.mechanism.joints(self.p1(time))
        return Target(self.rig.truth.pixels(q), np.full(3, np.nan))


def circle(rig: Rig, settings: Settings) -> Circle:
    """The circle about the scene's target."""
    middle = rig.body.points(rig.scene.target)[0]
    n = middle / np.linalg.norm(middle)
    across = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    across /= np.linalg.norm(across)
    along = (np.cross(n, across) + n) / np.sqrt(2.0)
    return Circle(rig, middle, settings.radius * across, settings.radius * along, settings.period)


def follow(settings: Settings, method: Learner, seed: int) -> dict[str, Any]:
    """Explore, go to the path's first point, then servo to reference pixels that move along it."""
    rig, plant = laboratory(seed, settings.scene, settings.noise)
    path = circle(rig, settings)
    servo = servo_for(rig, method.estimator, method.exploration, settings.controller)
    state, target, began = servo.init(), path.reference(0.0), None
    trace = Trace(path)
    servo.warm_up()
    plant.enable()
    longest = servo.exploration.max_time + settings.approach + settings.period
    for k, _ in enumerate(ticks(plant.clock, duration=longest)):
        seen = plant.read()
        if began is None and at_start(state):
            began = seen.now
        if began is not None:
            time = (seen.now - began) / 1e9
            if time > settings.period:
                break
            target = path.reference(time)
            if k % EVERY == 0:
                trace.look(time)
        state = servo.step(state, seen, target)
        plant.send(state.command)
        if state.phase in (Phase.PAUSED, Phase.FAULT):
            break
    return {"seed": seed, **trace.verdict(state.cause)}


def at_start(state: State) -> bool:
    """Whether the servo sees the tool at the path's first point."""
    return state.phase is Phase.SERVO and bool(np.max(np.abs(state.delta) / SCALE) < AT_START)


class Trace:
    """Where marker 1 truly was along a path, and where it should have been."""

    def __init__(self, path: Circle) -> None:
        self._path = path
        self._times: list[float] = []
        self._points: list[Floats] = []
        self._pixels: list[Floats] = []

    def look(self, time: float) -> None:
        """Take note of where marker 1 is now, `time` s after the start of the path."""
        rig = self._path.rig
        q = rig.arm.q_true
        self._times.append(time)
        self._points.append(rig.body.points(q)[0])
        self._pixels.append(rig.truth.pixels(q)[0])

    def verdict(self, cause: Cause) -> dict[str, Any]:
        """Errors in mm and px over the path, the ``lag`` s that explains most, and the ``beside``
        mm that it leaves."""
        if not self._times or self._times[-1] <= self._path.period - NEAR_END:
            return {"completed": False, "cause": cause.value or "time ran out before its start"}
        wanted = np.array([self._path.reference(time).points[0] for time in self._times])
        errors = self._behind(0.0)
        lags = np.arange(0.0, LONGEST_LAG, 0.02)
        left = [rms(self._behind(lag)) for lag in lags]
        return {
            "completed": True,
            "rms": rms(errors),
            "max": float(errors.max()),
            "pixels_rms": rms(np.linalg.norm(np.array(self._pixels) - wanted, axis=1)),
            "lag": float(lags[np.argmin(left)]),
            "beside": float(min(left)),
            "times": self._times,
            "errors": errors.tolist(),
            "seen": np.array(self._pixels).tolist(),
            "wanted": wanted.tolist(),
        }

    def _behind(self, lag: float) -> Floats:
        """How far marker 1 was from where it should have been `lag` s before, mm, at every time."""
        wanted = np.array([self._path.p1(time - lag) for time in self._times])
        return np.linalg.norm(np.array(self._points) - wanted, axis=1)


def chapter(settings: Settings, results: Results) -> Chapter:
    trials = {method: results[method].values["trials"] for method in METHODS}
    claims = [
        claim
        for method in METHODS
        for claim in _claims(METHODS[method].name, trials[method], settings)
    ]
    return Chapter(claims, [_figure(trials, settings)])


def _claims(name: str, trials: list[dict[str, Any]], settings: Settings) -> list[Claim]:
    done = [trial for trial in trials if trial["completed"]]
    causes = Counter(trial["cause"] for trial in trials if not trial["completed"])
    failures = "; ".join(
        f"{count} of {len(trials)} not completed: {cause}" for cause, count in causes.items()
    )
    of = {
        key: median([trial[key] for trial in done])
        for key in ("rms", "max", "pixels_rms", "lag", "beside")
    }
    worst = max((trial["max"] for trial in done), default=np.nan)
    start = median([trial["errors"][0] for trial in done])
    late = f"the start counts too, where the tool is still {start:.1f} mm from the reference"
    beside = "; ".join(filter(None, (failures, late if of["beside"] > 0.3 else "")))
    return [
        Claim(
            f"{name} follows moving reference pixels round the whole path in every scene",
            "Intro, [10]",
            100.0 * len(done) / len(trials),
            "%",
            ">=",
            100.0,
            settings.seeds,
            remark=failures,
            detail=f"circle of {settings.radius:g} mm in {settings.period:g} s, "
            f"{settings.speed:.1f} mm/s",
            figure="path",
        ),
        Claim(
            f"{name} follows moving reference pixels within 1.5 v/k, v/k being the lag of a law "
            f"without feed-forward",
            "Intro, [10]",
            of["rms"],
            "mm rms",
            "<=",
            1.5 * settings.lag,
            settings.seeds,
            remark=failures,
            detail=f"median over the scenes; v/k = {settings.lag:.2f} mm; in a scene at most "
            f"{of['max']:.2f} mm "
            f"(median), {worst:.2f} mm (worst), {of['pixels_rms']:.1f} px rms in the picture",
            figure="path",
        ),
        Claim(
            f"{name} keeps within 0.3 mm of the path, but for its lag",
            "Intro, [10]",
            of["beside"],
            "mm rms",
            "<=",
            0.3,
            settings.seeds,
            remark=beside,
            detail=f"median over the scenes, after a lag of {of['lag']:.2f} s; "
            f"1/k is {1.0 / settings.controller.gain:.2f} s",
            figure="path",
        ),
    ]


def _figure(trials: dict[str, list[dict[str, Any]]], settings: Settings) -> Shown:
    completed = {
        method: [trial for trial in some if trial["completed"]] for method, some in trials.items()
    }
    completed = {method: some for method, some in completed.items() if some}
    pictures: list[Curve] = []
    errors: list[Curve] = []
    for style, (method, some) in enumerate(completed.items()):
        label, one = METHODS[method].short, some[0]
        if not pictures:
            pictures.append(_picture("reference", one["wanted"], -1))
        pictures.append(_picture(label, one["seen"], style))
        shortest = min(len(trial["errors"]) for trial in some)
        middle = np.median([trial["errors"][:shortest] for trial in some], axis=0)
        errors.append(curve(label, one["times"][:shortest], middle, style))
    panels = [
        Panel("u [px]", "v [px], downwards", pictures, y_limits=_downwards(pictures)),
        Panel(
            "time on the path [s]",
            "$\\|p_1 - p_{ref}\\|$ [mm]",
            errors,
            levels=[("v/k", settings.lag)],
        ),
    ]
    seed = next((some[0]["seed"] for some in completed.values()), None)
    caption = (
        f"Left, marker 1 in the picture of scene {seed}; right, how far it is from the moving "
        f"reference, median over "
        "the scenes."
    )
    return Shown(
        "path", "[10]", caption, settings.seeds, Figure("Following a path", panels, columns=2)
    )


def _picture(label: str, pixels: list[list[float]], style: int) -> Curve:
    return curve(label, [u for u, _ in pixels], [v for _, v in pixels], style)


def _downwards(curves: Sequence[Curve]) -> tuple[float, float]:
    """Limits of an axis of v, which grows downwards as in the picture."""
    v = [value for one in curves for value in one.y if value is not None] or [0.0]
    return max(v) + 3.0, min(v) - 3.0


EXPERIMENT = Experiment(
    name="path-following",
    title="Following a path",
    about="Path following by moving reference pixels, as in [10]: our default and the paper's "
    "flow rule, without a "
    "calibration and without feed-forward.",
    whole=Settings(),
    quick=Settings(seeds=(0,), approach=8.0, radius=5.0, period=15.0),
    tasks=tasks,
    chapter=chapter,
)
