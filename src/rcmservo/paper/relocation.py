"""Experiment `relocation`: the camera is moved and rolled during a run, as section V claims.

The servo must detect the relocation and stop. Then the operator, simulated by this module, teaches
the target in the new view and returns the tool, and the servo restarts with an exploration.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.control.exploration import Exploration
from rcmservo.estimation.base import Estimator
from rcmservo.figures.charts import Figure, Panel, make_curve
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.interfaces import Target
from rcmservo.loop.run import Tick
from rcmservo.paper.lab.closed_loop import (
    FAST_FIT,
    FAST_LAW,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    POINT_NOISE_PX,
    ClosedLoop,
    closed_loop,
    make_servo,
    read_task_record,
)
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, finite, fraction, median
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.sim import RigSettings, SceneSettings

PAPER_BOUND_MM = 4.0
RELOCATION_METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (FAST_FIT, Exploration()),
    "flow": (FLOW_ESTIMATOR, FLOW_EXPLORATION),
}
RELOCATION_LABORATORY = RigSettings(
    scene=SceneSettings(room=12.0, travel=(30.0, 60.0)), point_noise=POINT_NOISE_PX
)


def fixed_settings() -> dict[str, object]:
    return {
        "methods": RELOCATION_METHODS,
        "controller": FAST_LAW,
        "laboratory": RELOCATION_LABORATORY,
    }


def tasks(settings: Settings) -> list[Task]:
    cost = (0.35 if settings.pictures else 0.05) * 2.0 * settings.duration
    found = list[Task]()
    for method in RELOCATION_METHODS:
        work = partial(relocated, method=method, settings=settings)
        found += Task.per_seed(method, work, range(settings.seeds), cost, in_folder=True)
    return found


def relocated(folder: Path, seed: int, method: str, settings: Settings) -> TaskResult:
    """Servo, relocate the camera half-way, wait for the stop, teach the target, and restart.

    Returns the results of `until_stopped`, the time ``again`` (s) of the restart, the cause at the
    end, and the final pose error (mm).
    """
    servo = make_servo(RELOCATION_LABORATORY, *RELOCATION_METHODS[method], FAST_LAW)
    with closed_loop(folder, seed, RELOCATION_LABORATORY, settings.pictures, servo) as loop:
        target, p_d = loop.teach(loop.rig.scene.target)
        loop.rig.move_to_start()
        stop = until_stopped(loop, target, settings)
        stopped_at = loop.rig.arm.q_true
        target, _ = loop.teach(loop.rig.scene.target)
        loop.rig.place(stopped_at)
        restart = loop.elapsed()
        tick = loop.last(target, settings.duration)
        words = "after: the target was taught in the new view"
        loop.snapshot("after.png", target, tick.state, words)
        error = np.linalg.norm(loop.true_p2() - p_d)
    return {**stop, "again": restart, "cause": tick.state.cause.stop_sentence, "pose_error": error}


def until_stopped(loop: ClosedLoop, target: Target, settings: Settings) -> TaskResult:
    """Servo to the target, relocate the camera on the path, and wait until the tool is at rest.

    Returns ``moved``, the time (s) of the relocation, None if the servo did not come that far;
    ``stopped_after``, the time (s) from the relocation until rest, or None; ``travelled``, the
    distance (mm) of marker 2 from the relocation to the end; and ``noticed``, True if the servo
    paused because it detected the relocation.
    """
    moved, stopped, p2, first = None, None, loop.true_p2(), np.nan
    tick: Tick | None = None
    for tick in loop.stage(target, settings.duration):
        if moved is None and tick.state.phase is Phase.SERVO:
            size = float(np.linalg.norm(tick.state.delta / FEATURE_SCALE))
            first = size if np.isnan(first) else first
            if size < settings.share * first:
                loop.snapshot("before.png", target, tick.state, "before")
                loop.rig.relocate_camera()
                moved, p2 = tick.time / 1e9, loop.true_p2()
        elif moved is not None and stopped is None and not tick.state.command.rates.any():
            stopped = tick.time / 1e9
    assert tick is not None
    words = "camera moved and rolled: " + tick.state.phase.value
    loop.snapshot("moved.png", target, tick.state, words)
    return {
        "moved": moved,
        "stopped_after": None if moved is None or stopped is None else stopped - moved,
        "travelled": np.linalg.norm(loop.true_p2() - p2),
        "noticed": tick.state.cause is Cause.CAMERA_MOVED,
    }


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    names = [f"{method}-{seed}" for method in RELOCATION_METHODS for seed in range(settings.seeds)]
    runs, seeds = [results[name] for name in names], range(settings.seeds)
    errors = column(runs, "pose_error")
    failed = [
        f"{name}: {run['cause'] or 'not at the target'}"
        for name, run in zip(names, runs, strict=True)
        if run["pose_error"] > PAPER_BOUND_MM
    ]
    words = "; ".join([f"median {median(errors):.2f} mm", *failed])
    yield Measurement("gets-there", errors.max(), seeds, words=words)
    noticed = 100.0 * fraction(run["noticed"] for run in runs)
    yield Measurement("noticed", noticed, seeds, runs=len(runs), gain=FAST_LAW.gain)
    after = column(runs, "stopped_after")
    yield Measurement(
        "stands-still",
        100.0 * fraction(after <= settings.stops),
        seeds,
        times=", ".join(f"{time:.2f}" for time in finite(after)),
        farthest=column(runs, "travelled").max(),
    )


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    folder = results.folders["projection-0"]
    pictures = [folder / f"{name}.png" for name in ("before", "moved", "after")]
    if all(path.exists() for path in pictures):
        yield ReportFigure("pictures", [0], pictures=pictures)
    panels = [_over_time(method, f"{method}-0", results) for method in RELOCATION_METHODS]
    yield ReportFigure("relocated", [0], Figure("Relocation of the camera during a run", panels))


def _over_time(method: str, task: str, results: Results) -> Panel:
    rows, run = read_task_record(results.folders[task]), results[task]
    new = rows.new_frames()
    size = np.linalg.norm(rows.ticks["delta"][new] / FEATURE_SCALE, axis=1)
    label = f"scaled $|\\Delta y|$\n{method}"
    spans = [] if run["moved"] is None else [(run["moved"], run["again"])]
    return Panel(
        "time [s]", label, [make_curve("", rows.time[new], size)], shaded=spans, log_y=True
    )
