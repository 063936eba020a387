"""Check of eq. (33): its assumption J Ĵ⁻¹ ≈ I and its conclusion V̇ ≤ 0, along regulations.

Experiment `stability`; the controller itself is in control/saturated_controller.py. V decreases if
the symmetric part of J Ĵ⁻¹ is positive definite. Both are computed with the true J in each frame of
closed loops with the paper's gains and either of its estimators.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from rcmservo.control.saturated_controller import compute_potential_gradient, scale_rows
from rcmservo.figures.charts import Figure, Panel
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Floats
from rcmservo.loop.servo_loop import Tick, servo_ticks
from rcmservo.loop.teach import teach
from rcmservo.paper.lab.closed_loop import make_servo
from rcmservo.paper.lab.evaluation import laboratory
from rcmservo.paper.lab.paper_settings import (
    PAPER_CONTROLLER,
    PAPER_METHODS,
    PAPER_SCENES,
    POINT_NOISE_PX,
    TEACHING_FRAMES,
)
from rcmservo.paper.plan import (
    Measurement,
    NotMeasured,
    PaperFigure,
    Results,
    Settings,
    Task,
    TaskResult,
    Texts,
)
from rcmservo.paper.statistics import curve_per_label, median
from rcmservo.safety.state_machine import Phase
from rcmservo.servo.servo import State
from rcmservo.sim import Rig

UNITY_BOUND = 0.3
"""Largest ‖J Ĵ⁻¹ − I‖₂ for which J Ĵ⁻¹ ≈ I holds."""
MIN_FALLING_FRACTION = 0.99
"""Smallest fraction of the frames with V̇ ≤ 0 of a stable regulation."""
NOISE_STANDARD_DEVIATIONS = 3.0
"""Error Δy, in standard deviations of its noise in one frame, up to which it may be noise only."""
RESULT_LABELS = {
    "least": "$\\lambda_{min}$, sym. J Ĵ⁻¹",
    "V_dot": "V̇ [1/s]",
    "unity": "‖J Ĵ⁻¹ − I‖",
}
METHOD_NAMES = {"projection": "projection-based", "flow": "flow-based"}


def tasks(settings: Settings) -> list[Task]:
    work, seeds = partial(regulate, settings=settings), range(settings.seeds)
    costs = {"projection": 6.0, "flow": 10.0}.items()
    per_method = [Task.per_seed(m, partial(work, estimator=m), seeds, cost) for m, cost in costs]
    return [task for method_tasks in per_method for task in method_tasks]


def regulate(settings: Settings, estimator: str, seed: int) -> TaskResult:
    """Regulate with the paper's gains; return `evaluate_frame` in each frame to the target.

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
        for tick in servo_ticks(plant, servo, home, 2.0 * settings.duration, until=has_arrived):
            state = tick.state
    else:
        rig.go_home()
    rows, newest_frame, cause = list[tuple[float, ...]](), -1, ""
    for tick in servo_ticks(
        plant, servo, target, settings.duration, until=has_arrived, state=state
    ):
        state, cause = tick.state, tick.state.cause.stop_sentence
        if state.phase is Phase.SERVO and state.newest_frame > newest_frame:
            newest_frame = state.newest_frame
            rows.append((tick.time / 1e9, *evaluate_frame(rig, state, tick.observation.q_exposure)))
    names = ("time", "least", "V_dot", "in_noise", "unity")
    columns = dict(zip(names, np.array(rows, dtype=float).reshape(-1, 5).T, strict=True))
    arrived = bool(rows) and bool(columns["in_noise"][-1] < 1.0)
    return {**columns, "cause": cause, "arrived": arrived}


def has_arrived(tick: Tick) -> bool:
    """Return True if the error in the newest frame is within `NOISE_STANDARD_DEVIATIONS`.

    The first second of a stage never counts, because its error belongs to the previous target.
    """
    return tick.time > 1e9 and tick.state.explored and error_in_noise(tick.state) < 1.0


def error_in_noise(state: State) -> float:
    """Return the largest component of Δy, in units of `NOISE_STANDARD_DEVIATIONS`."""
    d = state.y[2]
    noise = POINT_NOISE_PX * np.array([np.sqrt(2.0) / d, 1.0, np.sqrt(2.0)])
    return float(np.max(np.abs(state.delta) / (NOISE_STANDARD_DEVIATIONS * noise)))


def evaluate_frame(rig: Rig, state: State, q: Floats) -> tuple[float, float, float, float]:
    """Return λ_min of sym. J Ĵ⁻¹, V̇ (1/s) of the command, `error_in_noise`, and ‖J Ĵ⁻¹ − I‖₂.

    Matrices are scaled, and V is in units of (10°, 10 px, 10 px)². J is the true Jacobian at the
    joints `q` (3,) of the exposure.
    """
    J, J_hat = scale_rows(rig.truth.jacobian(q, state.o_c)), scale_rows(state.J_hat)
    product = J @ np.linalg.inv(J_hat)
    least = np.linalg.eigvalsh(0.5 * (product + product.T))[0]
    bounds = PAPER_CONTROLLER.bounds_array / FEATURE_SCALE
    gradient = compute_potential_gradient(state.delta / FEATURE_SCALE, bounds, False)
    unity = np.linalg.norm(product - np.eye(3), 2)
    return float(least), float(gradient @ J @ state.v), error_in_noise(state), float(unity)


def above_noise(run: TaskResult, name: str) -> Floats:
    """Return a result in the frames with an error above the noise.

    Raises
    ------
    NotMeasured
        If there is no such frame, as in a run that never reached SERVO.
    """
    values = run[name][run["in_noise"] > 1.0]
    if len(values) == 0:
        raise NotMeasured(f"{name} in SERVO with an error above the noise", np.nan)
    return values


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    runs = {method: results.per_seed(method, seeds) for method in PAPER_METHODS}
    falls = {
        method: min(float(np.mean(above_noise(run, "V_dot") <= 0.0)) for run in method_runs)
        for method, method_runs in runs.items()
    }
    least = {
        method: min(above_noise(run, "least").min() for run in method_runs)
        for method, method_runs in runs.items()
    }
    texts = {method: Texts(summary=summarise_runs(runs[method])) for method in runs}
    for method, name in METHOD_NAMES.items():
        yield Measurement("V-falls", falls[method], seeds, case=(name,), **texts[method])
    for method, name in METHOD_NAMES.items():
        medians = [median(above_noise(run, "unity")) for run in runs[method]]
        is_inaccurate = max(medians) > UNITY_BOUND
        is_stable = least[method] > 0.0 and falls[method] >= MIN_FALLING_FRACTION
        pitfall = Texts(remarked=is_inaccurate, confirmed=is_stable)
        arrived = sum(run["arrived"] for run in runs[method])
        listed = ", ".join(f"{value:.2f}" for value in medians)
        counts = Texts(arrived=arrived, runs=len(medians), medians=listed)
        yield Measurement("unity", max(medians), seeds, case=(name,), **pitfall, **counts)
    for method, name in METHOD_NAMES.items():
        value, case = least[method], (name,)
        yield Measurement(
            "definite", value, seeds, case=case, confirmed=value > 0.0, **texts[method]
        )


def summarise_runs(runs: list[TaskResult]) -> str:
    causes = [f"seed {seed}: {run['cause']}" for seed, run in enumerate(runs) if run["cause"]]
    frames = sum(len(above_noise(run, "time")) for run in runs)
    arrived = sum(run["arrived"] for run in runs)
    counts = f"smallest of {len(runs)} runs, {arrived} of which arrived; {frames} frames"
    return "; ".join([f"{counts} with an error above three times the noise", *causes])


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    panels = list[Panel]()
    for key, label in RESULT_LABELS.items():
        names = {m: name if key == "least" else "" for m, name in METHOD_NAMES.items()}

        def over_time(method: str, key: str = key) -> tuple[Floats, Floats]:
            run = results[f"{method}-0"]
            return above_noise(run, "time"), above_noise(run, key)

        levels = [] if key == "unity" else [("", 0.0)]
        panels.append(Panel("time [s]", label, curve_per_label(names, over_time), levels))
    yield PaperFigure("stability", [0], Figure("Stability along a regulation", panels))
