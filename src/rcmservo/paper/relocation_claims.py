"""Check of section V: the camera is moved and rolled during a run.

Experiment `relocation`. The servo must detect the relocation and stop. Then the operator, simulated
by this module, teaches the target in the new view and returns the tool, and the servo restarts with
an exploration.
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
from rcmservo.loop.servo_loop import Tick
from rcmservo.paper.lab.closed_loop import ClosedLoop, closed_loop, make_servo, read_task_record
from rcmservo.paper.lab.paper_settings import (
    FAST_CONTROLLER,
    FAST_ESTIMATOR,
    FLOW_ESTIMATOR,
    FLOW_EXPLORATION,
    PAPER_MAX_POSE_ERROR_MM,
    POINT_NOISE_PX,
)
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, finite, fraction, median
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import Phase
from rcmservo.sim import RigSettings, SceneSettings

RELOCATION_METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (FAST_ESTIMATOR, Exploration()),
    "flow": (FLOW_ESTIMATOR, FLOW_EXPLORATION),
}
SCENES = SceneSettings(room=12.0, travel=(30.0, 60.0))
LABORATORY = RigSettings(scene=SCENES, point_noise=POINT_NOISE_PX)


def tasks(settings: Settings) -> list[Task]:
    cost = (0.35 if settings.pictures else 0.05) * 2.0 * settings.duration
    all_tasks = list[Task]()
    for method in RELOCATION_METHODS:
        work = partial(relocate, method=method, settings=settings)
        all_tasks += Task.per_seed(method, work, range(settings.seeds), cost, in_folder=True)
    return all_tasks


def relocate(folder: Path, seed: int, method: str, settings: Settings) -> TaskResult:
    """Servo, relocate the camera half-way, wait for the stop, teach the target, and restart.

    Returns the results of `servo_until_stopped`, the time ``again`` (s) of the restart, the cause
    at the end, and the final pose error (mm).
    """
    servo = make_servo(LABORATORY, *RELOCATION_METHODS[method], FAST_CONTROLLER)
    with closed_loop(folder, seed, LABORATORY, settings.pictures, servo) as loop:
        target, p_d = loop.teach(loop.rig.scene.target)
        loop.rig.go_home()
        stop = servo_until_stopped(loop, target, settings)
        q_stop = loop.rig.truth.arm.q_true
        target, _ = loop.teach(loop.rig.scene.target)
        loop.rig.place(q_stop)
        restart = loop.elapsed()
        tick = loop.finish_stage(target, settings.duration)
        caption = "after: the target was taught in the new view"
        loop.write_snapshot("after.png", target, tick.state, caption)
        error = np.linalg.norm(loop.true_p2() - p_d)
    return {**stop, "again": restart, "cause": tick.state.cause.stop_sentence, "pose_error": error}


def servo_until_stopped(loop: ClosedLoop, target: Target, settings: Settings) -> TaskResult:
    """Servo to the target, relocate the camera on the path, and wait until the tool is at rest.

    Returns ``moved``, the time (s) of the relocation, None if the servo did not come that far;
    ``stopped_after``, the time (s) from the relocation until rest, or None; ``travelled``, the
    distance (mm) of marker 2 from the relocation to the end; and ``noticed``, True if the servo
    paused because it detected the relocation.
    """
    moved, stopped, p2, first_error = None, None, loop.true_p2(), np.nan
    tick: Tick | None = None
    for tick in loop.run_stage(target, settings.duration):
        if moved is None and tick.state.phase is Phase.SERVO:
            error = float(np.linalg.norm(tick.state.delta / FEATURE_SCALE))
            first_error = error if np.isnan(first_error) else first_error
            if error < settings.share * first_error:
                loop.write_snapshot("before.png", target, tick.state, "before")
                loop.rig.relocate_camera()
                moved, p2 = tick.time / 1e9, loop.true_p2()
        elif moved is not None and stopped is None and not tick.state.command.rates.any():
            stopped = tick.time / 1e9
    assert tick is not None
    caption = "camera moved and rolled: " + tick.state.phase.value
    loop.write_snapshot("moved.png", target, tick.state, caption)
    return {
        "moved": moved,
        "stopped_after": None if moved is None or stopped is None else stopped - moved,
        "travelled": np.linalg.norm(loop.true_p2() - p2),
        "noticed": tick.state.cause is Cause.CAMERA_MOVED,
    }


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = range(settings.seeds)
    names = [f"{method}-{seed}" for method in RELOCATION_METHODS for seed in seeds]
    runs = [results[name] for name in names]
    errors = column(runs, "pose_error")
    failures = [
        f"{name}: {results[name]['cause'] or 'not at the target'}"
        for name, error in zip(names, errors, strict=True)
        if error > PAPER_MAX_POSE_ERROR_MM
    ]
    summary = "; ".join([f"median {median(errors):.2f} mm", *failures])
    yield Measurement("gets-there", errors.max(), seeds, summary=summary)
    noticed = 100.0 * fraction(run["noticed"] for run in runs)
    yield Measurement("noticed", noticed, seeds, runs=len(runs), gain=FAST_CONTROLLER.gain)
    after = column(runs, "stopped_after")
    in_time, times = 100.0 * fraction(after <= settings.stops), [f"{t:.2f}" for t in finite(after)]
    texts = Texts(times=", ".join(times), farthest=column(runs, "travelled").max())
    yield Measurement("stands-still", in_time, seeds, **texts)


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    folder = results.folders["projection-0"]
    pictures = [folder / f"{name}.png" for name in ("before", "moved", "after")]
    if all(path.exists() for path in pictures):
        yield PaperFigure("pictures", [0], pictures=pictures)
    panels = list[Panel]()
    for method in RELOCATION_METHODS:
        record, run = read_task_record(results.folders[f"{method}-0"]), results[f"{method}-0"]
        new = record.new_frames()
        error = np.linalg.norm(record.ticks["delta"][new] / FEATURE_SCALE, axis=1)
        label, curves = f"scaled $|\\Delta y|$\n{method}", [make_curve("", record.time[new], error)]
        stopped_spans = [] if run["moved"] is None else [(run["moved"], run["again"])]
        panels.append(Panel("time [s]", label, curves, shaded=stopped_spans, log_y=True))
    yield PaperFigure("relocated", [0], Figure("Relocation of the camera during a run", panels))
