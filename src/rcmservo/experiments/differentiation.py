"""What the differentiation of y costs: once per new frame, or once per tick, with 60 frames/s in a
100 Hz loop.

One tour, on which the flow rule (28) learns from ẏ taken in every way, beside the true ẏ.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.cameras import PINHOLE, true_parameters
from rcmservo.experiments.harness.lab.closed_loop import FAST_ARM, FLOW, LONG, NOISE, for_ever
from rcmservo.experiments.harness.lab.witness import laboratory
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import marks, median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run import Tick, run
from rcmservo.method.controller import scaled
from rcmservo.method.estimators.flow import learn
from rcmservo.method.features import about, difference, features
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig

WAYS = {
    "frame": "once per new frame, between exposures",
    "tick": "once per tick, repeated frames show no motion",
    "stale": "frame interval, zeros in between",
}
SHORT = ["by frame", "by tick", "zeros between"]
TOUR = for_ever(LONG)
LAST_TOURS = 5.0
"""s at the end of a tour over which Ĵ is judged: the error of a flow rule comes and goes with every
round."""


@dataclass(frozen=True)
class Settings:
    """Tours on which the flow rule learns."""

    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    """Of the scenes, one tour in each."""
    touring: float = 25.0
    """s."""
    gamma: float = 0.001
    """γ of the flow rule."""


@dataclass(frozen=True)
class Taken:
    """One way of taking ẏ, on one tour."""

    ratio: float
    """Mean ẏ over the true one, by least squares."""
    scatter: float
    """What it misses of the true one, relative."""
    size: float
    """Of Ĵ along J, median."""
    error: float
    """‖Ĵ − J‖/‖J‖, scaled, median."""


@dataclass(frozen=True)
class Tour:
    """Every way of taking ẏ on one tour."""

    frame: Taken
    """Once per new frame, over the time between the exposures."""
    tick: Taken
    """Once per tick, over the tick's interval; a repeated frame shows no motion."""
    stale: Taken
    """Once per tick, over the frames' interval; zero where a frame repeats."""

    def of(self, way: str) -> Taken:
        return {"frame": self.frame, "tick": self.tick, "stale": self.stale}[way]


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(f"tour-{seed}", partial(tour, settings=settings, seed=seed)) for seed in settings.seeds
    ]


def tour(folder: Path, settings: Settings, seed: int) -> Tour:
    """One tour, and ẏ taken in three ways: its size against the true one, its scatter, and the Ĵ
    that the flow rule learns from it."""
    del folder
    rig, plant = laboratory(seed, PINHOLE, NOISE)
    known = rig.settings
    servo = Servo(known.mechanism, known.tool, estimator=FLOW, exploration=TOUR, gate=FAST_ARM)
    here = Target(rig.truth.pixels(rig.scene.start), rig.scene.start)
    comparison = Comparison(rig, servo, settings.gamma)
    for tick in run(plant, servo, here, settings.touring):
        comparison.look(tick)
        if tick.time / 1e9 > settings.touring - LAST_TOURS:
            comparison.judge()
    return comparison.found()


class Comparison:
    """The same ticks through every way of taking ẏ."""

    def __init__(self, rig: Rig, servo: Servo, gamma: float) -> None:
        self._rig, self._servo = rig, servo
        _, self._o_c = true_parameters(rig)
        self._period = 1.0 / rig.settings.timing.frame_rate
        self._ways = {name: Differentiated(gamma) for name in WAYS}
        self._last: Tick | None = None
        self._true = np.zeros(3)

    def look(self, tick: Tick) -> None:
        """One tick; before a first frame has shown the markers there is nothing to take."""
        if not np.isfinite(tick.seen.points).all():
            return
        last, self._last = self._last, tick
        if last is None:
            return
        marker, seen, before = self._servo.marker_1, tick.seen, last.seen
        tau, delta_y = (tick.time - last.time) * 1e-9, changed(tick, last, self._o_c)
        if seen.frame > before.frame:
            self._true = true_flow(self._rig, seen.exposure, self._o_c)
            exposed = marker(seen.q_exposure) - marker(before.q_exposure)
            dt = (seen.exposure - before.exposure) * 1e-9
            self._ways["frame"].add(exposed, delta_y, dt, self._true)
        moved = marker(seen.q) - marker(before.q)
        self._ways["tick"].add(moved, delta_y, tau, self._true)
        self._ways["stale"].add(moved, delta_y / self._period * tau, tau, self._true)

    def judge(self) -> None:
        """Compare every Ĵ with the true J of now."""
        J = self._rig.truth.jacobian(self._rig.arm.q_true, self._o_c)
        for way in self._ways.values():
            way.judge(J)

    def found(self) -> Tour:
        return Tour(**{name: way.found() for name, way in self._ways.items()})


def changed(tick: Tick, last: Tick, o_c: Floats) -> Floats:
    """Change of y (3,) from one tick to the next, as the newest frames of both show it."""
    return difference(
        features(about(tick.seen.points, o_c)), features(about(last.seen.points, o_c))
    )


def true_flow(rig: Rig, time: int, o_c: Floats) -> Floats:
    """True ẏ (3,) at a moment ns of the last second."""
    half = 5_000_000
    before, after = (
        rig.body.points(rig.truth.joints_at(time + side * half))[0] for side in (-1, 1)
    )
    return rig.truth.jacobian(rig.truth.joints_at(time), o_c) @ (after - before) / (2e-9 * half)


class Differentiated:
    """The flow rule (28) on one way of taking ẏ, and that ẏ beside the true one."""

    def __init__(self, gamma: float) -> None:
        self.gamma, self.J_hat = gamma, np.zeros((3, 3))
        self.product, self.square, self.missed = 0.0, 0.0, 0.0
        self.sizes: list[float] = []
        self.errors: list[float] = []

    def add(self, delta_p: Floats, delta_y: Floats, dt: float, true: Floats) -> None:
        """Learn from Δp₁ mm and Δy over dt s; ``true`` (3,) is the true ẏ."""
        self.J_hat = learn(self.J_hat, delta_p, delta_y, dt, self.gamma)
        taken, right = scaled((delta_y / dt)[:, None]), scaled(true[:, None])
        self.product += dt * float(np.sum(taken * right))
        self.square += dt * float(np.sum(right**2))
        self.missed += dt * float(np.sum((taken - right) ** 2))

    def judge(self, J: Floats) -> None:
        """Compare the present Ĵ with the true J (3, 3)."""
        J_hat, J = scaled(self.J_hat), scaled(J)
        self.sizes.append(float(np.sum(J_hat * J) / np.sum(J**2)))
        self.errors.append(float(np.linalg.norm(J_hat - J) / np.linalg.norm(J)))

    def found(self) -> Taken:
        return Taken(
            ratio=self.product / self.square,
            scatter=float(np.sqrt(self.missed / self.square)),
            size=median(self.sizes),
            error=median(self.errors),
        )


@dataclass(frozen=True)
class ToursFound:
    """All tours, and their medians by the way of taking ẏ."""

    settings: Settings
    """What the tours were made with."""
    tours: list[Tour]
    """One for each seed."""

    def middle(self, way: str) -> Taken:
        """Medians over the seeds."""
        some = [tour.of(way) for tour in self.tours]
        return Taken(
            median([one.ratio for one in some]),
            median([one.scatter for one in some]),
            median([one.size for one in some]),
            median([one.error for one in some]),
        )

    def learnt(self, way: str) -> str:
        one = self.middle(way)
        return f"size {one.size:.2f} of J, error {one.error:.2f}"


def chapter(settings: Settings, results: Results) -> Chapter:
    found = ToursFound(settings, results.all(Tour, "tour", settings.seeds))
    claims = [zeros_between(found), by_tick(found), by_frame(found)]
    return Chapter(claims, [_figure(found)])


def zeros_between(found: ToursFound) -> Claim:
    stale = found.middle("stale")
    return Claim(
        "ẏ by the frames' interval at every tick, zero where a frame repeats, has its true size: "
        "ratio",
        "sixty",
        stale.ratio,
        "of ẏ",
        ">=",
        0.95,
        found.settings.seeds,
        follows=True,
        remark=f"ẏ is {stale.ratio:.2f} of the true one, and the flow rule's Ĵ comes to "
        f"{found.learnt('stale')}",
        figure="frames",
        trap="T12",
        confirmed=abs(stale.ratio - 0.6) < 0.05,
    )


def by_tick(found: ToursFound) -> Claim:
    tick, frame = found.middle("tick"), found.middle("frame")
    return Claim(
        "ẏ by the tick's interval at every tick does the flow rule no harm: error of its Ĵ over "
        "that by frames",
        "sixty",
        median([tour.tick.error / tour.frame.error for tour in found.tours]),
        "x the error",
        "<=",
        1.1,
        found.settings.seeds,
        follows=True,
        remark=f"ẏ keeps its mean size ({tick.ratio:.2f}), but its scatter is {tick.scatter:.2f} "
        f"of it, by frames {frame.scatter:.2f}",
        detail=f"Ĵ comes to {found.learnt('tick')}",
        figure="frames",
    )


def by_frame(found: ToursFound) -> Claim:
    frame = found.middle("frame")
    return Claim(
        "differentiated once per new frame, with the motion between the exposures, ẏ has its true "
        "size: off by",
        OURS,
        abs(frame.ratio - 1.0),
        "of ẏ",
        "<=",
        0.03,
        found.settings.seeds,
        detail=f"ratio {frame.ratio:.3f}, scatter {frame.scatter:.2f}; Ĵ of the flow rule after "
        f"{found.settings.touring:g} s: {found.learnt('frame')}",
        figure="frames",
    )


def _figure(found: ToursFound) -> Shown:
    words: dict[str, Callable[[Taken], float]] = {
        "size of $\\dot{y}$ over the true [1]": lambda one: one.ratio,
        "scatter of $\\dot{y}$ over the true [1]": lambda one: one.scatter,
        "size of $\\hat{J}$ along J [1]": lambda one: one.size,
        "$\\|\\hat{J} - J\\| / \\|J\\|$, scaled [1]": lambda one: one.error,
    }
    panels = [
        Panel(
            "",
            label,
            [marks([[number(tour.of(way)) for tour in found.tours] for way in WAYS])],
            categories=SHORT,
        )
        for label, number in words.items()
    ]
    caption = (
        "60 frames/s in a 100 Hz loop, on one tour at 30 mm/s, "
        f"{found.settings.touring:g} s. By frame: {WAYS['frame']}; by tick: {WAYS['tick']}; zeros "
        f"between: {WAYS['stale']}. One mark for each seed."
    )
    figure = Figure("Differentiating y", panels, columns=2)
    return Shown("frames", "IV-A", caption, found.settings.seeds, figure)


EXPERIMENT = Experiment(
    name="differentiation",
    title="Sensitivity: the differentiation of y",
    about="ẏ once per new frame, as ours is, beside ẏ once per tick of a loop that is faster "
    "than the camera.",
    whole=Settings(),
    quick=Settings(seeds=(0,), touring=8.0),
    tasks=tasks,
    chapter=chapter,
)
