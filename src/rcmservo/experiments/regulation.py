"""One regulation experiment of the paper, for either estimator: from initial errors of exactly
[40°, 80 px, 60 px].

The tool explores from nothing, goes back to the start at the paper's gains, and on to the target
that it was shown. A run is faithful only if Ĵ is within 30 % of J after exploration and r falls by
k b = 1 px/s ± 30 % while saturated: a small Ĵ multiplies k, and its quick success is not the
paper's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rcmservo.experiments.harness.claims import Claim, Results, Shown, Task, median, rms
from rcmservo.experiments.harness.closed_loop import (
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
from rcmservo.figures import plots
from rcmservo.figures.charts import Figure, Panel, curve
from rcmservo.guard.states import Cause
from rcmservo.interfaces import Floats
from rcmservo.loop.run import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.method.estimators.base import Estimator
from rcmservo.method.exploration import Exploration
from rcmservo.record.reader import Record
from rcmservo.sim import RigSettings, SceneSettings

PERCENT = 0.02
ACCURATE = 0.3
SLOPE = 0.3
ENOUGH = 10
"""Seeds of which a bar speaks, and the bounds of a faithful run."""

AT_REST = 2.0
"""s at the end over which the remaining error is taken."""

SEEN = 0.1
"""s after which the servo has seen its new target's error, and the tool has hardly moved."""


@dataclass(frozen=True)
class Regulation:
    """What both regulation experiments share.

    ``scene`` holds the errors at the start; ``half_way`` explores where half of them are left;
    ``back`` s are allowed for the way back to the start, ``duration`` s from there on; ``shown`` is
    the seed of the figures; ``noise`` px where there are no ``pictures``.
    """

    seeds: Sequence[int] = tuple(range(12))
    shown: int = 0
    scene: SceneSettings = PAPER_SCENES
    estimator: Estimator = PRINTED_FIT
    exploration: Exploration = WIDE
    half_way: bool = False
    controller: SaturatedController = PRINTED_LAW
    lines: int = 50
    back: float = 150.0
    duration: float = 110.0
    pictures: bool = True
    noise: float = NOISE

    def rig(self) -> RigSettings:
        """The laboratories that the seeds draw from."""
        return RigSettings(scene=self.scene, point_noise=self.noise)

    @property
    def errors(self) -> Floats:
        """|Δy| (3,) rad, px, px at the start."""
        return np.abs(np.array(self.scene.errors, dtype=float))


def regulation_tasks(settings: Regulation) -> list[Task]:
    """One closed loop for every seed."""
    cost = (0.35 if settings.pictures else 0.03) * (settings.duration + 80.0)
    return [
        Task(f"seed-{seed}", regulate, {"seed": seed, "settings": settings}, cost)
        for seed in settings.seeds
    ]


def regulate(folder: Path, seed: int, settings: Regulation) -> dict[str, Any]:
    """Explore, go back to the start, regulate; what was measured, from the record."""

    def servo(rig: Any) -> Any:
        return servo_for(
            rig, settings.estimator, settings.exploration, settings.controller, settings.lines
        )

    with ClosedLoop(folder, seed, settings.rig(), settings.pictures, servo) as loop:
        scene = loop.rig.scene
        home, _ = loop.shown(scene.start)
        target, p_d = loop.shown(scene.target)
        loop.rig.place(scene.half_way if settings.half_way else scene.start)
        tick = loop.explore(home)
        began = None
        if tick.state.explored:
            tick = loop.last(home, settings.back, tick.state, done=Arrived())
            began = loop.elapsed()
            for count, there in enumerate(loop.stage(target, settings.duration, tick.state)):
                tick = there
                if count == round(100 * SEEN):
                    loop.snapshot("initial.png", target, tick.state, _words("initial", tick))
            loop.snapshot("final.png", target, tick.state, _words("final", tick))
        cause = tick.state.cause.value
    rows = recorded(folder)
    return measured(rows, began, p_d, cause, settings)


def _words(when: str, tick: Tick) -> str:
    s, r, d = np.abs(tick.state.delta) * plots.DEGREES
    return f"{when}: |ds| {s:.2f} deg  |dr| {r:.2f} px  |dd| {d:.2f} px"


def measured(
    rows: Record, began: float | None, p_d: Floats, cause: str, settings: Regulation
) -> dict[str, Any]:
    """The numbers of a run, from its record: errors of Ĵ, slopes, what is left of the errors, the
    pose error mm."""
    error = rows.truth["jacobian_error"][:, 0]
    explored = np.array([phase not in ("IDLE", "ACQUIRE") for phase in rows.phase])
    values: dict[str, Any] = {"cause": cause, "began": began}
    if began is None:
        return {**values, "cause": cause or Cause.NOT_EXPLORED.value, "explored": float("nan")}
    on = rows.time >= began
    new = rows.new_frames(began + SEEN)
    sizes = np.abs(rows.ticks["delta"][new])
    time = rows.time[new] - began
    last = time > time[-1] - AT_REST
    left = np.sqrt(np.mean(sizes[last] ** 2, axis=0)) / settings.errors
    pose = np.linalg.norm(rows.truth["p2"] - p_d, axis=1)
    below = (sizes < PERCENT * settings.errors).all(axis=1)
    bounds = np.array(settings.controller.bounds)
    return {
        **values,
        "explored_at": float(rows.time[np.argmax(explored)]),
        "explored": float(error[np.argmax(explored)]),
        "at_start": float(error[np.argmax(on)]),
        "at_end": float(error[-1]),
        "initial": np.mean(sizes[:6], axis=0).tolist(),
        "slopes": [
            slope(time, sizes[:, i] * plots.DEGREES[i], bounds[i] * plots.DEGREES[i])
            for i in range(3)
        ],
        "left": left.tolist(),
        "time_to_2_percent": float(time[np.argmax(below)]) if below.any() else None,
        "pose": rms(pose[rows.time > rows.time[-1] - 1.0]),
    }


def slope(time: Floats, size: Floats, bound: float) -> float:
    """Fall of an error in units/s while it is saturated, above 1.2 b, by least squares."""
    saturated = size > 1.2 * bound
    if saturated.sum() < 10:
        return float("nan")
    return float(-np.polyfit(time[saturated], size[saturated], 1)[0])


def faithful(values: dict[str, Any]) -> bool:
    """Whether a run is the paper's: Ĵ near J after exploration, and the speed that the gains ask
    for."""
    return bool(values["explored"] <= ACCURATE and abs(values["slopes"][1] - 1.0) <= SLOPE)


def succeeded(values: dict[str, Any]) -> bool:
    """Whether every component fell below 2 % of its initial error and the servo did not stop."""
    return not values["cause"] and max(values["left"]) < PERCENT


def why_not(values: dict[str, Any]) -> str:
    """In words, why a run does not count."""
    if values["began"] is None or values["cause"]:
        return values["cause"]
    if values["explored"] > ACCURATE:
        return f"Ĵ off by {values['explored']:.0%} after exploration"
    if abs(values["slopes"][1] - 1.0) > SLOPE:
        return f"r fell by {values['slopes'][1]:.2f} px/s"
    return f"{max(values['left']):.1%} of an error left"


def regulation_claims(settings: Regulation, results: Results, where: str, trap: str) -> list[Claim]:
    """The claims that both regulation experiments make."""
    runs = {seed: results[f"seed-{seed}"].values for seed in settings.seeds}
    good = {seed: run for seed, run in runs.items() if _counts(run)}
    rest = [f"seed {seed}: {why_not(run)}" for seed, run in runs.items() if seed not in good]
    begun = [run for run in runs.values() if run["began"] is not None]
    enough = min(ENOUGH, len(runs))
    seeds = list(runs)
    slopes = np.array([run["slopes"][1] for run in begun])
    left = [max(run["left"]) for run in good.values()]
    poses = [run["pose"] for run in good.values()]
    return [
        Claim(
            f"regulation succeeds: every error falls below 2 % of its initial value, in a "
            f"faithful run, for {enough} "
            "seeds",
            f"IV-B, {where}",
            len(good),
            f"of {len(runs)} seeds",
            ">=",
            enough,
            seeds,
            detail="; ".join([*_starts(settings, begun), *rest]),
            figure="seeds",
        ),
        Claim(
            "the largest error left in these runs, as a share of its initial value",
            f"IV-B, {where}",
            max(left, default=float("nan")),
            "",
            "<=",
            PERCENT,
            list(good),
            detail=f"pose error ‖p₂ − p_d‖ median {median(poses):.2f} mm, worst "
            f"{max(poses, default=np.nan):.2f} mm",
            figure="errors",
        ),
        Claim(
            "Ĵ approximates J: scaled ‖Ĵ − J‖/‖J‖ after exploration, median",
            "IV-B",
            median([run["explored"] for run in begun]),
            "",
            "<=",
            ACCURATE,
            seeds,
            detail=f"worst {max((run['explored'] for run in begun), default=np.nan):.2f}; at the "
            f"start "
            f"{median([run['at_start'] for run in begun]):.2f}, at the end "
            f"{median([run['at_end'] for run in begun]):.2f} (medians)",
            figure="seeds",
        ),
        Claim(
            "k = 0.1 with b = 10 is an error that falls by 1 px/s: |slope of r − 1 px/s|, median",
            "(33), IV-A",
            median(np.abs(slopes - 1.0)),
            "px/s",
            "<=",
            SLOPE,
            seeds,
            detail=f"slopes {slopes.min():.2f} to {slopes.max():.2f} px/s" if len(slopes) else "",
            figure="seeds",
            trap=trap,
        ),
    ]


def _starts(settings: Regulation, begun: list[dict[str, Any]]) -> list[str]:
    """How near the runs began to the errors that they were to begin with."""
    if not begun:
        return []
    away = np.array([run["initial"] for run in begun]) - settings.errors
    s, r, d = np.max(np.abs(away), axis=0) * plots.DEGREES
    s_0, r_0, d_0 = settings.errors * plots.DEGREES
    return [
        f"initial errors [{s_0:.0f}°, {r_0:.0f} px, {d_0:.0f} px], as the servo measures them "
        f"about its o_c to within "
        f"{s:.2f}°, {r:.1f} px, {d:.1f} px"
    ]


def _counts(run: dict[str, Any]) -> bool:
    return run["began"] is not None and faithful(run) and succeeded(run)


def regulation_figures(
    settings: Regulation, results: Results, paper: tuple[str, str]
) -> list[Shown]:
    """Fig. 7 or 8 (pictures) and 9 or 10 (errors) of the seed shown, and all seeds."""
    result = results[f"seed-{settings.shown}"]
    rows = recorded(result.folder)
    pictures = [result.folder / name for name in ("initial.png", "final.png")]
    shown = [
        Shown(
            "errors",
            paper[1],
            "Magnitude of the error coordinates from the start on.",
            [settings.shown],
            regulation_errors(rows, result.values, settings),
        ),
        Shown(
            "seeds",
            "All seeds",
            "Every run: the error of Ĵ after exploration, the slope of r "
            "while saturated, and "
            "the largest share of an initial error that is left; dashed: the bounds of a "
            "faithful run.",
            list(settings.seeds),
            _seeds(settings, results),
        ),
    ]
    if all(path.exists() for path in pictures):
        caption = (
            "Initial and final picture: features y in blue, target y_d in black, imaged "
            "RCM as a cross."
        )
        shown.insert(0, Shown("pictures", paper[0], caption, [settings.shown], pictures=pictures))
    return shown


def regulation_errors(
    rows: Record, values: dict[str, Any], settings: Regulation, until: float = float("inf")
) -> Figure:
    """Magnitude of the error coordinates from the start on, for `until` s: Fig. 9 and 10."""
    began = values["began"] or 0.0
    on = (rows.time >= began + SEEN) & (rows.time <= began + until)
    sizes = np.abs(rows.ticks["delta"][on]) * plots.DEGREES
    ends = settings.errors * PERCENT * plots.DEGREES
    panels = [
        Panel(
            "time [s]",
            name,
            [curve("", rows.time[on] - began, sizes[:, i])],
            levels=[("2 %", float(ends[i]))],
        )
        for i, name in enumerate(plots.ERRORS)
    ]
    return Figure("Error coordinates", panels)


def _seeds(settings: Regulation, results: Results) -> Figure:
    runs = [results[f"seed-{seed}"].values for seed in settings.seeds]
    nothing = {"slopes": [np.nan] * 3, "left": [np.nan]}
    places = np.arange(len(runs))
    explored = [run["explored"] for run in runs]
    slopes = [{**nothing, **run}["slopes"][1] for run in runs]
    left = [100.0 * max({**nothing, **run}["left"]) for run in runs]
    names = [str(seed) for seed in settings.seeds]
    scaled = "$\\|\\hat J - J\\| / \\|J\\|$"
    bands = [("", 1.0 - SLOPE), ("", 1.0 + SLOPE)]
    return Figure(
        "All seeds",
        [
            Panel(
                "seed",
                scaled,
                [curve("", places, explored, 0, True)],
                [("30 %", ACCURATE)],
                categories=names,
            ),
            Panel(
                "seed",
                "slope of r [px/s]",
                [curve("", places, slopes, 1, True)],
                bands,
                categories=names,
            ),
            Panel(
                "seed",
                "left [%]",
                [curve("", places, left, 2, True)],
                [("2 %", 100.0 * PERCENT)],
                log_y=True,
                categories=names,
            ),
        ],
    )
