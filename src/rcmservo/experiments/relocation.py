"""What the conclusions claim in passing: the camera may be relocated, here moved and rolled in the
middle of a run.

The servo must notice and stop. Then a person shows the target in the new view and puts the tool
back to where it was, and the servo explores anew and goes on. (The script plays the person.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import (
    Chapter,
    Claim,
    Experiment,
    Result,
    Results,
    Shown,
    Task,
    median,
)
from rcmservo.experiments.harness.closed_loop import (
    FLOW,
    LONG,
    NOISE,
    ClosedLoop,
    recorded,
    servo_for,
)
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.states import Cause, Phase
from rcmservo.loop.run import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.estimators.projection import ProjectionEstimator
from rcmservo.method.exploration import Exploration
from rcmservo.method.features import SCALE
from rcmservo.sim import Rig, RigSettings, SceneSettings

PAPER = 4.0
STOPS = 0.25
"""s within which the tool must stand still: 3 frames to notice, and the ramp from full speed."""

METHODS: dict[str, tuple[Estimator, Exploration]] = {
    "projection": (ProjectionEstimator(), Exploration()),
    "flow": (FLOW, LONG),
}


@dataclass(frozen=True)
class Settings:
    """The camera is relocated when ``share`` of the way in Δy is left; ``duration`` s of each
    part."""

    seeds: Sequence[int] = (0, 1, 2)
    share: float = 0.5
    duration: float = 50.0
    controller: SaturatedController = field(default_factory=SaturatedController)
    scene: SceneSettings = field(
        default_factory=lambda: SceneSettings(room=12.0, travel=(30.0, 60.0))
    )
    pictures: bool = True
    noise: float = NOISE


def tasks(settings: Settings) -> list[Task]:
    cost = (0.35 if settings.pictures else 0.05) * 2.0 * settings.duration
    return [
        Task(
            f"{method}-{seed}",
            relocated,
            {"seed": seed, "method": method, "settings": settings},
            cost,
        )
        for seed in settings.seeds
        for method in METHODS
    ]


def relocated(folder: Path, seed: int, method: str, settings: Settings) -> dict[str, Any]:
    """Servo, relocate the camera half-way, see the tool stop, show the target anew, and go on from
    nothing."""
    rig_settings = RigSettings(scene=settings.scene, point_noise=settings.noise)
    estimator, exploration = METHODS[method]

    def servo(rig: Rig) -> Any:
        return servo_for(rig, estimator, exploration, settings.controller)

    with ClosedLoop(folder, seed, rig_settings, settings.pictures, servo) as loop:
        target, p_d = loop.shown(loop.rig.scene.target)
        loop.rig.go_home()
        values = _until_stopped(loop, target, settings)
        stopped_at = loop.rig.arm.q_true
        target, _ = loop.shown(loop.rig.scene.target)
        loop.rig.place(stopped_at)
        values["again"] = loop.elapsed()
        tick = loop.last(target, settings.duration)
        loop.snapshot(
            "after.png", target, tick.state, "after: the target was shown in the new view"
        )
        error = float(np.linalg.norm(loop.true_p2() - p_d))
    explored = tick.state.explored
    return {
        **values,
        "explored": explored,
        "end_cause": tick.state.cause.value,
        "pose_error": error,
    }


def _until_stopped(loop: ClosedLoop, target: Any, settings: Settings) -> dict[str, Any]:
    """Servo to the target, move the camera on the way, and see when and why the tool stands
    still."""
    first, moved, stopped = np.nan, None, None
    p2 = loop.true_p2()
    cause = Cause.NONE
    tick: Tick | None = None
    for tick in loop.stage(target, settings.duration):
        if tick.state.phase is Phase.SERVO and moved is None:
            size = float(np.linalg.norm(tick.state.delta / SCALE))
            first = size if np.isnan(first) else first
            if size < settings.share * first:
                loop.snapshot("before.png", target, tick.state, "before")
                loop.rig.relocate_camera()
                moved, p2 = tick.time / 1e9, loop.true_p2()
        elif moved is not None and stopped is None and not tick.state.command.rates.any():
            stopped = tick.time / 1e9
    if tick is not None:
        cause = tick.state.cause
        loop.snapshot(
            "moved.png",
            target,
            tick.state,
            "the camera was moved and rolled: " + tick.state.phase.value,
        )
    return {
        "moved": moved,
        "stopped_after": None if moved is None or stopped is None else stopped - moved,
        "travelled": float(np.linalg.norm(loop.true_p2() - p2)),
        "cause": cause.value,
        "noticed": cause is Cause.CAMERA_MOVED,
    }


def chapter(settings: Settings, results: Results) -> Chapter:
    runs = {name: result.values for name, result in results.items()}
    count = f"of {len(runs)} runs"
    noticed = [run for run in runs.values() if run["noticed"]]
    after = [run["stopped_after"] for run in runs.values()]
    slowest = max((np.inf if value is None else value) for value in after)
    errors = [run["pose_error"] for run in runs.values()]
    failed = [
        f"{name}: {run['end_cause'] or 'not there'}"
        for name, run in runs.items()
        if run["pose_error"] > PAPER
    ]
    claims = [
        Claim(
            "a camera that is moved and rolled in mid-run is noticed, and the servo pauses for "
            "that reason",
            "V, Remark 2",
            len(noticed),
            count,
            ">=",
            len(runs),
            settings.seeds,
            detail="both estimators, default gains",
            figure="relocated",
        ),
        Claim(
            "the tool stands still soon after the camera was moved, slowest run",
            "ours",
            slowest,
            "s",
            "<=",
            STOPS,
            settings.seeds,
            detail=f"it went on by {max(run['travelled'] for run in runs.values()):.1f} mm at most",
            figure="relocated",
        ),
        Claim(
            "the camera can be relocated arbitrarily: with the target shown in the new view the "
            "servo explores anew "
            "and gets there, largest pose error",
            "V",
            max(errors),
            "mm",
            "<=",
            PAPER,
            settings.seeds,
            remark="a target that was registered in the old view is lost with it and must be "
            "shown again",
            detail=f"median {median(errors):.2f} mm" + ("; " + "; ".join(failed) if failed else ""),
            figure="relocated",
        ),
    ]
    return Chapter(claims, _figures(settings, results))


def _figures(settings: Settings, results: Results) -> list[Shown]:
    seed = settings.seeds[0]
    shown = results[f"projection-{seed}"]
    pictures = [
        path
        for name in ("before", "moved", "after")
        if (path := shown.folder / f"{name}.png").exists()
    ]
    panels = [_over_time(method, results[f"{method}-{seed}"]) for method in METHODS]
    caption = (
        "The feature error as the servo knows it. Shaded: the camera was moved, the servo has "
        "stopped, and the person "
        "shows the target anew; then it explores and goes on."
    )
    figures = [
        Shown("relocated", "V", caption, [seed], Figure("The camera relocated in mid-run", panels))
    ]
    if pictures:
        caption = (
            "Before the camera was moved, after it (the old target is meaningless now), "
            "and at the end."
        )
        figures.insert(0, Shown("pictures", "V", caption, [seed], pictures=pictures))
    return figures


def _over_time(method: str, result: Result) -> Panel:
    rows = recorded(result.folder)
    new = rows.new_frames()
    size = np.linalg.norm(rows.ticks["delta"][new] / SCALE, axis=1)
    label = f"scaled $|\\Delta y|$\n{method}"
    moved = result.values["moved"]
    spans = [(moved, result.values["again"])] if moved is not None else []
    return Panel("time [s]", label, [curve("", rows.time[new], size)], shaded=spans, log_y=True)


EXPERIMENT = Experiment(
    name="relocation",
    title="The camera relocated",
    about="“to arbitrarily relocate the camera to observe different regions of interest” (V): "
    "the camera is moved and "
    "rolled in the middle of a run.",
    whole=Settings(),
    quick=Settings(seeds=(0,), pictures=False),
    tasks=tasks,
    chapter=chapter,
)
