"""(33), as a measurement: V falls along a regulation if the symmetric part of J Ĵ⁻¹ is positive
definite.

Closed loops with the printed gains and either estimator; the truth judges every frame.
"""

from dataclasses import dataclass
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
)
from rcmservo.experiments.harness.closed_loop import (
    NOISE,
    PAPER_METHODS,
    PAPER_SCENES,
    PRINTED_LAW,
    servo_for,
)
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.states import Phase
from rcmservo.interfaces import Floats
from rcmservo.loop.plant import Plant
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.method.controller import potential_gradient, scaled
from rcmservo.method.features import SCALE
from rcmservo.servo.servo import State
from rcmservo.sim import Rig, RigSettings
from rcmservo.tracking import PointMarkers

NEAR_UNITY = 0.3
"""‖J Ĵ⁻¹ − I‖₂ up to which J Ĵ⁻¹ counts as about I; 1 would be enough for a positive definite
symmetric part."""


@dataclass(frozen=True)
class Settings:
    """``duration`` s of the way to the target."""

    seeds: tuple[int, ...] = (0, 1, 2, 3)
    duration: float = 150.0


def tasks(settings: Settings) -> list[Task]:
    return [
        Task(
            f"{name}-{seed}",
            regulate,
            {"settings": settings, "estimator": name, "seed": seed},
            cost=cost,
        )
        for name, cost in (("projection", 6.0), ("flow", 10.0))
        for seed in settings.seeds
    ]


def regulate(folder: Path, settings: Settings, estimator: str, seed: int) -> dict[str, Any]:
    """A regulation with the printed gains, judged in every frame while it servoes to the target.

    The flow rule explores half-way, is then servoed to the start, and from there to the target.
    """
    del folder
    rig = Rig(seed, RigSettings(scene=PAPER_SCENES, point_noise=NOISE), pictures=False)
    plant = Plant(rig.arm, rig.camera, PointMarkers(), rig.clock)
    servo = servo_for(rig, *PAPER_METHODS[estimator])
    servo.warm_up()
    home = teach(plant)
    rig.show_target()
    target = teach(plant)
    state = None
    if estimator == "flow":
        rig.place(rig.scene.half_way)
        for tick in run(plant, servo, home, 2.0 * settings.duration, done=arrived):
            state = tick.state
    else:
        rig.go_home()
    frames: list[list[float]] = []
    seen, cause = -1, ""
    for tick in run(plant, servo, target, settings.duration, done=arrived, state=state):
        cause = tick.state.cause.value
        if tick.state.phase is Phase.SERVO and tick.state.frame > seen:
            seen = tick.state.frame
            frames.append([tick.time / 1e9, *judge(rig, tick.state, tick.seen.q_exposure)])
    return {"frames": frames, "cause": cause, "arrived": bool(frames) and frames[-1][3] < 1.0}


def arrived(tick: Tick) -> bool:
    """Whether the newest frame shows the target within three times the noise; asked from the second
    second on, when the error is no more that of a stage before."""
    return tick.time > 1e9 and tick.state.explored and in_noise(tick.state) < 1.0


def in_noise(state: State) -> float:
    """The largest component of Δy over three times the noise that one frame has in it."""
    d = state.y[2]
    noise = NOISE * np.array([np.sqrt(2.0) / d, 1.0, np.sqrt(2.0)])
    return float(np.max(np.abs(state.delta) / (3.0 * noise)))


def judge(rig: Rig, state: State, q: Floats) -> list[float]:
    """λ_min of the symmetric part of J Ĵ⁻¹, V̇ of the velocity commanded, |Δy| over 3 x its noise,
    and ‖J Ĵ⁻¹ − I‖₂.

    All scaled: V in units of (10°, 10 px, 10 px)². J is the true one where the frame was exposed.
    """
    J, J_hat = scaled(rig.truth.jacobian(q, state.o_c)), scaled(state.J_hat)
    closed = J @ np.linalg.inv(J_hat)
    least = np.linalg.eigvalsh(0.5 * (closed + closed.T))[0]
    gradient = potential_gradient(state.delta / SCALE, PRINTED_LAW.b / SCALE, False)
    return [
        float(least),
        float(gradient @ J @ state.v),
        in_noise(state),
        float(np.linalg.norm(closed - np.eye(3), 2)),
    ]


def chapter(settings: Settings, results: Results) -> Chapter:
    claims = [claim for name in PAPER_METHODS for claim in _claims(settings, results, name)]
    return Chapter(claims, [_figure(settings, results)])


def judged_frames(settings: Settings, results: Results, estimator: str) -> list[Floats]:
    """Per seed the rows [time, λ_min, V̇, |Δy| over 3 x noise, ‖J Ĵ⁻¹ − I‖₂] of frames that show an
    error."""
    runs = [results[f"{estimator}-{seed}"].values["frames"] for seed in settings.seeds]
    frames = [np.array(run, dtype=float).reshape(-1, 5) for run in runs]
    return [rows[rows[:, 3] > 1.0] for rows in frames]


def _claims(settings: Settings, results: Results, name: str) -> list[Claim]:
    seeds = settings.seeds
    runs = judged_frames(settings, results, name)
    share = min(float(np.mean(rows[:, 2] <= 0.0)) for rows in runs)
    least = min(float(rows[:, 1].min()) for rows in runs)
    off = [median(rows[:, 4]) for rows in runs]
    values = [results[f"{name}-{seed}"].values for seed in seeds]
    there = sum(one["arrived"] for one in values)
    causes = [
        f"seed {seed}: {one['cause']}"
        for seed, one in zip(seeds, values, strict=True)
        if one["cause"]
    ]
    about = f"{name}-based estimator with the printed gains"
    detail = (
        f"least over {len(runs)} runs, of which {there} arrived; {sum(map(len, runs))} frames "
        f"with an error above "
        "three times the noise"
    )
    positive = least > 0.0
    return [
        Claim(
            f"V falls: V̇ ≤ 0 in every frame of a regulation ({about})",
            "(33)",
            share,
            "share of frames",
            ">=",
            0.99,
            seeds,
            detail="; ".join([detail, *causes]),
            figure="stability",
        ),
        Claim(
            f"J Ĵ⁻¹ ≈ I, as (33) assumes ({about})",
            "III-D",
            max(off),
            "‖J Ĵ⁻¹ − I‖₂",
            "<=",
            NEAR_UNITY,
            seeds,
            remark=""
            if max(off) <= NEAR_UNITY
            else f"{there} of {len(runs)} runs arrived all the same: positive definite is enough",
            detail="medians of the runs: " + ", ".join(f"{one:.2f}" for one in off),
            figure="stability",
            trap="T15",
            confirmed=positive and share >= 0.99,
        ),
        Claim(
            f"the symmetric part of J Ĵ⁻¹ is positive definite in every frame ({about})",
            "ours",
            least,
            "λ_min",
            ">=",
            0.0,
            seeds,
            detail=detail,
            figure="stability",
            trap="T15",
            confirmed=positive,
        ),
    ]


def _figure(settings: Settings, results: Results) -> Shown:
    rows = {name: judged_frames(settings, results, name)[0] for name in PAPER_METHODS}
    parts = {1: "$\\lambda_{min}$, sym. J Ĵ⁻¹", 2: "V̇ [1/s]", 4: "‖J Ĵ⁻¹ − I‖"}
    panels = [
        Panel(
            "time [s]",
            label,
            [
                curve(f"{name}-based" if column == 1 else "", some[:, 0], some[:, column], style)
                for style, (name, some) in enumerate(rows.items())
            ],
            levels=[] if column == 4 else [("", 0.0)],
        )
        for column, label in parts.items()
    ]
    caption = (
        "The loop on its way to the target, judged with the true J: the smallest eigenvalue of "
        "the symmetric part of "
        "J Ĵ⁻¹ (stable if positive), the slope of V under the velocity commanded, and how far J "
        "Ĵ⁻¹ is from I. "
        "All scaled to 10°, 10 px, 10 px."
    )
    seeds = [settings.seeds[0]]
    return Shown(
        "stability", "(33)", caption, seeds, Figure("Stability along a regulation", panels)
    )


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
