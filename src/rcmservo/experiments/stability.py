"""(33), as a measurement: V falls along a regulation if the symmetric part of J Ĵ⁻¹ is positive
definite.

Closed loops with the printed gains and either estimator; the truth judges every frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.closed_loop import (
    NOISE,
    PAPER_METHODS,
    PAPER_SCENES,
    PRINTED_LAW,
    SHOWN,
    servo_for,
)
from rcmservo.experiments.harness.lab.witness import laboratory
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import potential_gradient, scaled
from rcmservo.method.features import SCALE
from rcmservo.servo.servo import State
from rcmservo.sim import Rig

NEAR_UNITY = 0.3
"""‖J Ĵ⁻¹ − I‖₂ up to which J Ĵ⁻¹ counts as about I; 1 would be enough for a positive definite
symmetric part."""


@dataclass(frozen=True)
class Settings:
    """Regulations with the printed gains."""

    seeds: tuple[int, ...] = (0, 1, 2, 3)
    """Of the scenes, one regulation with each estimator in each."""
    duration: float = 150.0
    """s of the way to the target."""


@dataclass(frozen=True)
class Frames:
    """What the truth says of one regulation, frame by frame while it servoes to the target."""

    time: JsonFloats
    """s."""
    least: JsonFloats
    """λ_min of the symmetric part of J Ĵ⁻¹."""
    V_dot: JsonFloats
    """Of the velocity commanded, 1/s."""
    in_noise: JsonFloats
    """|Δy| over three times its noise."""
    off: JsonFloats
    """‖J Ĵ⁻¹ − I‖₂."""
    cause: str
    """What held the tool still at the last tick, in words; empty if nothing did."""
    arrived: bool
    """Whether the last frame shows the target within three times the noise."""

    @property
    def wide(self) -> NDArray[np.bool_]:
        """Which frames show an error above their noise."""
        return self.in_noise > 1.0


def tasks(settings: Settings) -> list[Task]:
    costs = {"projection": 6.0, "flow": 10.0}
    return [
        Task(
            f"{name}-{seed}", partial(regulate, settings=settings, estimator=name, seed=seed), cost
        )
        for name, cost in costs.items()
        for seed in settings.seeds
    ]


def regulate(folder: Path, settings: Settings, estimator: str, seed: int) -> Frames:
    """A regulation with the printed gains, judged in every frame while it servoes to the target.

    The flow rule explores half-way, is then servoed to the start, and from there to the target.
    """
    del folder
    rig, plant = laboratory(seed, PAPER_SCENES, NOISE)
    servo = servo_for(rig.settings, *PAPER_METHODS[estimator])
    servo.warm_up()
    home = teach(plant, SHOWN)
    rig.show_target()
    target = teach(plant, SHOWN)
    state = None
    if estimator == "flow":
        rig.place(rig.scene.half_way)
        for tick in run(plant, servo, home, 2.0 * settings.duration, done=arrived):
            state = tick.state
    else:
        rig.go_home()
    frames = list[tuple[float, ...]]()
    seen, cause = -1, ""
    for tick in run(plant, servo, target, settings.duration, done=arrived, state=state):
        cause = tick.state.cause.stopping
        if tick.state.phase is Phase.SERVO and tick.state.frame > seen:
            seen = tick.state.frame
            frames.append((tick.time / 1e9, *judge(rig, tick.state, tick.seen.q_exposure)))
    return _frames(frames, cause)


def _frames(rows: list[tuple[float, ...]], cause: str) -> Frames:
    time, least, V_dot, noisy, off = np.array(rows, dtype=float).reshape(-1, 5).T
    return Frames(time, least, V_dot, noisy, off, cause, bool(len(noisy)) and noisy[-1] < 1.0)


def arrived(tick: Tick) -> bool:
    """Whether the newest frame shows the target within three times the noise; asked from the second
    second on, when the error is no more that of a stage before."""
    return tick.time > 1e9 and tick.state.explored and in_noise(tick.state) < 1.0


def in_noise(state: State) -> float:
    """The largest component of Δy over three times the noise that one frame has in it."""
    d = state.y[2]
    noise = NOISE * np.array([np.sqrt(2.0) / d, 1.0, np.sqrt(2.0)])
    return float(np.max(np.abs(state.delta) / (3.0 * noise)))


def judge(rig: Rig, state: State, q: Floats) -> tuple[float, float, float, float]:
    """λ_min of the symmetric part of J Ĵ⁻¹, V̇ of the velocity commanded, |Δy| over 3 x its noise,
    and ‖J Ĵ⁻¹ − I‖₂.

    All scaled: V in units of (10°, 10 px, 10 px)². J is the true one where the frame was exposed.
    """
    J, J_hat = scaled(rig.truth.jacobian(q, state.o_c)), scaled(state.J_hat)
    closed = J @ np.linalg.inv(J_hat)
    least = np.linalg.eigvalsh(0.5 * (closed + closed.T))[0]
    gradient = potential_gradient(state.delta / SCALE, PRINTED_LAW.b / SCALE, False)
    off = np.linalg.norm(closed - np.eye(3), 2)
    return float(least), float(gradient @ J @ state.v), in_noise(state), float(off)


@dataclass(frozen=True)
class Runs:
    """All regulations with one estimator."""

    name: str
    """The estimator's in PAPER_METHODS."""
    frames: list[Frames]
    """One for each run."""
    seeds: tuple[int, ...]
    """Of the runs, in the same order."""

    @property
    def falls(self) -> float:
        """Share of the frames with an error in which V falls, in the worst run."""
        return min(float(np.mean(one.V_dot[one.wide] <= 0.0)) for one in self.frames)

    @property
    def least(self) -> float:
        """The least λ_min of all frames with an error."""
        return min(float(one.least[one.wide].min()) for one in self.frames)

    @property
    def there(self) -> int:
        return sum(one.arrived for one in self.frames)

    @property
    def words(self) -> str:
        pairs = zip(self.seeds, self.frames, strict=True)
        causes = [f"seed {seed}: {one.cause}" for seed, one in pairs if one.cause]
        count = sum(int(one.wide.sum()) for one in self.frames)
        about = (
            f"least over {len(self.frames)} runs, of which {self.there} arrived; {count} frames "
            "with an error above three times the noise"
        )
        return "; ".join([about, *causes])


def chapter(settings: Settings, results: Results) -> Chapter:
    runs = [
        Runs(name, results.all(Frames, name, settings.seeds), settings.seeds)
        for name in PAPER_METHODS
    ]
    claims = [claim(one) for claim in (V_falls, about_unity, positive_definite) for one in runs]
    return Chapter(claims, [_figure(runs)])


def V_falls(runs: Runs) -> Claim:
    return Claim(
        "V falls: V̇ ≤ 0 in every frame of a regulation, share of the frames",
        "stable-33",
        runs.falls,
        "of the frames",
        ">=",
        0.99,
        runs.seeds,
        case=(f"{runs.name}-based", ""),
        detail=runs.words,
        figure="stability",
    )


def about_unity(runs: Runs) -> Claim:
    off = [median(one.off[one.wide]) for one in runs.frames]
    return Claim(
        "J Ĵ⁻¹ ≈ I along a regulation: ‖J Ĵ⁻¹ − I‖₂, largest of the runs' medians",
        "unity",
        max(off),
        "",
        "<=",
        NEAR_UNITY,
        runs.seeds,
        case=(f"{runs.name}-based", ""),
        remark=f"{runs.there} of {len(off)} runs arrived all the same: positive definite is enough"
        if max(off) > NEAR_UNITY
        else "",
        detail="medians of the runs: " + ", ".join(f"{one:.2f}" for one in off),
        figure="stability",
        trap="T15",
        confirmed=runs.least > 0.0 and runs.falls >= 0.99,
    )


def positive_definite(runs: Runs) -> Claim:
    return Claim(
        "the symmetric part of J Ĵ⁻¹ is positive definite in every frame: least eigenvalue",
        OURS,
        runs.least,
        "",
        ">=",
        0.0,
        runs.seeds,
        case=(f"{runs.name}-based", ""),
        detail=runs.words,
        figure="stability",
        trap="T15",
        confirmed=runs.least > 0.0,
    )


def _figure(runs: list[Runs]) -> Shown:
    shown = [one.frames[0] for one in runs]

    def panel(label: str, of: Callable[[Frames], Floats], level: bool, labelled: bool) -> Panel:
        curves = [
            curve(
                f"{one.name}-based" if labelled else "",
                frames.time[frames.wide],
                of(frames)[frames.wide],
                style,
            )
            for style, (one, frames) in enumerate(zip(runs, shown, strict=True))
        ]
        return Panel("time [s]", label, curves, levels=[("", 0.0)] if level else [])

    panels = [
        panel("$\\lambda_{min}$, sym. J Ĵ⁻¹", lambda one: one.least, True, True),
        panel("V̇ [1/s]", lambda one: one.V_dot, True, False),
        panel("‖J Ĵ⁻¹ − I‖", lambda one: one.off, False, False),
    ]
    caption = (
        "The loop on its way to the target, judged with the true J: the smallest eigenvalue of "
        "the symmetric part of J Ĵ⁻¹ (stable if positive), the slope of V under the velocity "
        "commanded, and how far J Ĵ⁻¹ is from I. All scaled to 10°, 10 px, 10 px."
    )
    figure = Figure("Stability along a regulation", panels)
    return Shown("stability", "(33)", caption, [runs[0].seeds[0]], figure)


EXPERIMENT = Experiment(
    name="stability",
    title="Stability: V̇ and J Ĵ⁻¹ along runs",
    about="What (33) assumes and promises, judged by the truth in every frame of regulations "
    "with the printed gains.",
    whole=Settings(),
    quick=Settings(seeds=(0,)),
    tasks=tasks,
    chapter=chapter,
)
