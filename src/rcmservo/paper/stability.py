"""Experiment `stability`: assumption and conclusion of (33) along regulations.

V decreases if the symmetric part of J Ĵ⁻¹ is positive definite. Both are computed with the true J
in each frame of closed loops with the printed gains and either estimator.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import potential_gradient, scale_rows
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick, run
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.closed_loop import (
    PAPER_METHODS,
    PAPER_SCENES,
    POINT_NOISE_PX,
    PRINTED_LAW,
    TEACHING_FRAMES,
    make_servo,
)
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import median
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import State
from rcmservo.sim import Rig

UNITY_BOUND = 0.3
"""Largest ‖J Ĵ⁻¹ − I‖₂ for which J Ĵ⁻¹ ≈ I holds."""
RESULT_LABELS = {
    "least": "$\\lambda_{min}$, sym. J Ĵ⁻¹",
    "V_dot": "V̇ [1/s]",
    "unity": "‖J Ĵ⁻¹ − I‖",
}


def fixed_settings() -> dict[str, object]:
    return {"methods": PAPER_METHODS, "scene": PAPER_SCENES, "noise": POINT_NOISE_PX}


def tasks(settings: Settings) -> list[Task]:
    found = list[Task]()
    for name, cost in {"projection": 6.0, "flow": 10.0}.items():
        work = partial(regulate, settings=settings, estimator=name)
        found += Task.per_seed(name, work, range(settings.seeds), cost)
    return found


def regulate(settings: Settings, estimator: str, seed: int) -> TaskResult:
    """Regulate with the printed gains; return the results of `judge` in each frame to the target.

    With the flow rule, the tool explores half-way, then returns to the start before the regulation.
    """
    rig, plant = laboratory(seed, PAPER_SCENES, POINT_NOISE_PX)
    servo = make_servo(rig.settings, *PAPER_METHODS[estimator])
    servo.warm_up()
    home = teach(plant, TEACHING_FRAMES)
    rig.move_to_target()
    target = teach(plant, TEACHING_FRAMES)
    state = None
    if estimator == "flow":
        rig.place(rig.scene.midpoint)
        for tick in run(plant, servo, home, 2.0 * settings.duration, done=arrived):
            state = tick.state
    else:
        rig.move_to_start()
    rows = list[tuple[float, ...]]()
    frame, cause = -1, ""
    for tick in run(plant, servo, target, settings.duration, done=arrived, state=state):
        cause = tick.state.cause.stop_sentence
        if tick.state.phase is Phase.SERVO and tick.state.newest_frame > frame:
            frame = tick.state.newest_frame
            rows.append((tick.time / 1e9, *judge(rig, tick.state, tick.observation.q_exposure)))
    names = ("time", "least", "V_dot", "in_noise", "unity")
    columns = dict(zip(names, np.array(rows, dtype=float).reshape(-1, 5).T, strict=True))
    there = bool(rows) and columns["in_noise"][-1] < 1.0
    return {**columns, "cause": cause, "arrived": bool(there)}


def arrived(tick: Tick) -> bool:
    """Return True if the error in the newest frame is within three times the noise.

    The first second of a stage never counts, because its error belongs to the previous target.
    """
    return tick.time > 1e9 and tick.state.explored and in_noise(tick.state) < 1.0


def in_noise(state: State) -> float:
    """Return the largest component of Δy, in units of three times its noise in one frame."""
    d = state.y[2]
    noise = POINT_NOISE_PX * np.array([np.sqrt(2.0) / d, 1.0, np.sqrt(2.0)])
    return float(np.max(np.abs(state.delta) / (3.0 * noise)))


def judge(rig: Rig, state: State, q: Floats) -> tuple[float, float, float, float]:
    """Return λ_min of sym. J Ĵ⁻¹, V̇ (1/s) of the command, `in_noise`, and ‖J Ĵ⁻¹ − I‖₂.

    Matrices are scaled, and V is in units of (10°, 10 px, 10 px)². J is the true Jacobian at the
    joints `q` (3,) of the exposure.
    """
    J, J_hat = scale_rows(rig.truth.jacobian(q, state.o_c)), scale_rows(state.J_hat)
    closed = J @ np.linalg.inv(J_hat)
    least = np.linalg.eigvalsh(0.5 * (closed + closed.T))[0]
    gradient = potential_gradient(
        state.delta / FEATURE_SCALE, PRINTED_LAW.bounds_array / FEATURE_SCALE, False
    )
    unity = np.linalg.norm(closed - np.eye(3), 2)
    return float(least), float(gradient @ J @ state.v), in_noise(state), float(unity)


def above_noise(run: TaskResult, name: str) -> Floats:
    """Return a result in the frames with an error above three times the noise."""
    return run[name][run["in_noise"] > 1.0]


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    runs = {name: results.per_seed(name, seeds) for name in PAPER_METHODS}
    falls = {
        name: min(float(np.mean(above_noise(run, "V_dot") <= 0.0)) for run in some)
        for name, some in runs.items()
    }
    least = {
        name: min(above_noise(run, "least").min() for run in some) for name, some in runs.items()
    }
    words = {name: _words(some) for name, some in runs.items()}
    for name in runs:
        yield Measurement("V-falls", falls[name], seeds, case=(f"{name}-based",), words=words[name])
    for name, some in runs.items():
        medians = [median(above_noise(run, "unity")) for run in some]
        yield Measurement(
            "unity",
            max(medians),
            seeds,
            case=(f"{name}-based",),
            remarked=max(medians) > UNITY_BOUND,
            confirmed=least[name] > 0.0 and falls[name] >= 0.99,
            arrived=sum(run["arrived"] for run in some),
            runs=len(some),
            medians=", ".join(f"{one:.2f}" for one in medians),
        )
    for name in runs:
        yield Measurement(
            "definite",
            least[name],
            seeds,
            case=(f"{name}-based",),
            confirmed=least[name] > 0.0,
            words=words[name],
        )


def _words(runs: list[TaskResult]) -> str:
    causes = [f"seed {seed}: {run['cause']}" for seed, run in enumerate(runs) if run["cause"]]
    count, there = (
        sum(len(above_noise(run, "time")) for run in runs),
        sum(r["arrived"] for r in runs),
    )
    about = (
        f"smallest of {len(runs)} runs, {there} of which arrived; {count} frames "
        "with an error above three times the noise"
    )
    return "; ".join([about, *causes])


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    panels = [
        Panel(
            "time [s]",
            label,
            [
                make_curve(
                    f"{name}-based" if key == "least" else "",
                    above_noise(results[f"{name}-0"], "time"),
                    above_noise(results[f"{name}-0"], key),
                    style,
                )
                for style, name in enumerate(PAPER_METHODS)
            ],
            levels=[] if key == "unity" else [("", 0.0)],
        )
        for key, label in RESULT_LABELS.items()
    ]
    yield ReportFigure("stability", [0], Figure("Stability along a regulation", panels))
