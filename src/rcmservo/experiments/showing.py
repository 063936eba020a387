"""Learning by showing, Fig. 13 and 14: the tool is shown several poses once and goes round them by
their pictures.

A person brings the tool to each pose and registers what the camera sees; then the servo visits them
in turn, at the paper's gains. ‖Δp‖ = ‖p₂ − p_d‖ is taken by the truth when a visit ends (the paper
presumably took it by the joints).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.experiments.harness.claims import Chapter, Claim, Shown
from rcmservo.experiments.harness.lab.closed_loop import (
    NOISE,
    PAPER_METHODS,
    PRINTED_LAW,
    Arrived,
    ClosedLoop,
    recorded,
    servo_for,
)
from rcmservo.experiments.harness.lab.poses import drawn_poses, pose_per_pixel
from rcmservo.experiments.harness.plain import JsonFloats
from rcmservo.experiments.harness.sentences import OURS
from rcmservo.experiments.harness.statistics import median
from rcmservo.experiments.harness.tasks import Experiment, Results, Task
from rcmservo.figures import plots
from rcmservo.figures.charts import Curve, Figure, Panel, curve
from rcmservo.guard.causes import Cause
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run import Tick
from rcmservo.method.controller import SaturatedController
from rcmservo.servo.servo import Servo
from rcmservo.sim import Rig, RigSettings, SceneSettings

PAPER, MEDIAN = 4.0, 0.5
"""mm: the paper's bound on every visit, and ours on their median."""


@dataclass(frozen=True)
class Settings:
    """Scenes in which several poses are shown once and visited in turn."""

    rendered: tuple[int, ...] = (0,)
    """Seeds on rendered frames."""
    points: tuple[int, ...] = (1, 2, 3)
    """Seeds with the point camera."""
    poses: int = 6
    """How many are shown."""
    rounds: int = 3
    """How often every pose is visited."""
    spread: float = 14.0
    """mm about the start within which the poses lie."""
    longest: float = 150.0
    """s that a visit lasts at most."""
    controller: SaturatedController = PRINTED_LAW
    """Of both estimators."""
    scene: SceneSettings = field(default_factory=lambda: SceneSettings(room=18.0))
    """What the scenes are drawn from."""
    noise: float = NOISE
    """px of the point camera."""

    @property
    def seeds(self) -> list[int]:
        return [*self.rendered, *self.points]


@dataclass(frozen=True)
class Visit:
    """The servo at one pose."""

    pose: int
    """Its number among the poses shown, from 0."""
    began: float
    """s."""
    ended: float
    """s."""
    pose_error: float
    """mm of marker 2 from where it was shown."""
    jacobian_error: float
    """Scaled, of Ĵ."""


@dataclass(frozen=True)
class Visits:
    """All visits in one scene with one estimator."""

    made: list[Visit]
    """In the order in which they were made."""
    cause: str
    """Why the last one ended early; empty if it did not."""
    poses: JsonFloats
    """p_d (n, 3) mm of every pose."""
    per_pixel: list[float]
    """mm by which a pixel of noise misplaces the tool at every pose."""


def tasks(settings: Settings) -> list[Task]:
    seconds = 100.0 * settings.poses * settings.rounds
    return [
        Task(
            f"{method}-{seed}",
            partial(visit_all, seed=seed, method=method, pictures=pictures, settings=settings),
            cost=seconds * (0.35 if pictures else 0.08),
        )
        for seeds, pictures in ((settings.rendered, True), (settings.points, False))
        for seed in seeds
        for method in PAPER_METHODS
    ]


def visit_all(folder: Path, seed: int, method: str, pictures: bool, settings: Settings) -> Visits:
    """Show all poses, explore about the start, and visit the poses in turn."""
    laboratory = RigSettings(scene=settings.scene, point_noise=settings.noise)
    estimator, exploration = PAPER_METHODS[method]

    def servo(rig: Rig) -> Servo:
        return servo_for(rig.settings, estimator, exploration, settings.controller)

    with ClosedLoop(folder, seed, laboratory, pictures, servo) as loop:
        shown = [loop.shown(q) for q in drawn_poses(loop.rig, settings.poses, settings.spread)]
        targets = [target for target, _ in shown]
        loop.rig.go_home()
        tick = loop.explore(targets[0])
        loop.snapshot("snapshot-0.png", targets[0], tick.state, "after exploration", targets[1:])
        made = list[Visit]()
        for count in range(settings.rounds * settings.poses):
            pose = count % settings.poses
            if not tick.state.explored or tick.state.cause.stopping:
                break
            visit, tick = _visit(loop, tick, pose, shown[pose], settings)
            made.append(visit)
            if count < settings.poses:
                words = f"pose {pose + 1}: |dp| {visit.pose_error:.2f} mm"
                loop.snapshot(f"snapshot-{pose + 1}.png", targets[pose], tick.state, words)
        per_pixel = [pose_per_pixel(loop.rig, target.q) for target in targets]
    places = np.array([p_d for _, p_d in shown])
    unexplored = "" if tick.state.explored else Cause.NOT_EXPLORED.value
    return Visits(made, tick.state.cause.stopping or unexplored, places, per_pixel)


def _visit(
    loop: ClosedLoop, tick: Tick, pose: int, shown: tuple[Target, Floats], settings: Settings
) -> tuple[Visit, Tick]:
    """Servo to one pose, and where the tool then is."""
    target, p_d = shown
    began = loop.elapsed()
    tick = loop.last(target, settings.longest, tick.state, done=Arrived())
    away = float(np.linalg.norm(loop.true_p2() - p_d))
    off = loop.rig.truth.jacobian_error(tick.state.J_hat, tick.seen.q_exposure, tick.state.o_c)
    return Visit(pose, began, loop.elapsed(), away, off), tick


@dataclass(frozen=True)
class VisitsFound:
    """All scenes with one estimator."""

    settings: Settings
    """How many visits were asked for, and in which scenes."""
    method: str
    """The estimator's name in PAPER_METHODS."""
    scenes: list[Visits]
    """One for each seed, rendered ones first."""

    @property
    def visits(self) -> list[Visit]:
        return [visit for scene in self.scenes for visit in scene.made]

    @property
    def errors(self) -> list[float]:
        return [visit.pose_error for visit in self.visits]

    @property
    def rendered(self) -> list[float]:
        """mm on rendered frames, which are the first scenes."""
        scenes = self.scenes[: len(self.settings.rendered)]
        return [visit.pose_error for scene in scenes for visit in scene.made]

    def on_rendered(self, word: str, of: Callable[[list[float]], float]) -> str:
        rendered = self.rendered
        return f"; on rendered frames {word} {of(rendered):.2f} mm" if rendered else ""


def chapter(settings: Settings, results: Results) -> Chapter:
    found = [
        VisitsFound(settings, method, results.all(Visits, method, settings.seeds))
        for method in ("flow", "projection")
    ]
    claims = [claim(one) for claim in (within_4_mm, all_are_made) for one in found]
    claims += [meaning(found[0]), *(median_visit(one) for one in found)]
    return Chapter(claims, _figures(settings, results))


def within_4_mm(found: VisitsFound) -> Claim:
    J = [visit.jacobian_error for visit in found.visits]
    return Claim(
        "learning by showing: every visit ends within 4 mm of the pose that was shown, worst visit",
        "showing",
        max(found.errors, default=np.nan),
        "mm",
        "<=",
        PAPER,
        found.settings.seeds,
        case=(f"{found.method}-based", ""),
        detail=f"{len(found.visits)} visits in {len(found.scenes)} scenes; error of Ĵ at their "
        f"ends: median {median(J):.2f}, worst {max(J):.2f}{found.on_rendered('worst', max)}",
        figure="pose-error",
    )


def all_are_made(found: VisitsFound) -> Claim:
    asked = found.settings.poses * found.settings.rounds * len(found.scenes)
    causes = sorted({scene.cause for scene in found.scenes if scene.cause})
    return Claim(
        "every visit is made",
        "showing",
        100.0 * len(found.visits) / asked,
        "% of visits",
        ">=",
        100.0,
        found.settings.seeds,
        follows=True,
        case=(f"{found.method}-based", ""),
        detail="; ".join([f"{asked} asked for", *causes]),
        figure="visits",
    )


def median_visit(found: VisitsFound) -> Claim:
    return Claim(
        "the median visit ends within 0.5 mm",
        OURS,
        median(found.errors),
        "mm",
        "<=",
        MEDIAN,
        found.settings.seeds,
        case=(f"{found.method}-based", ""),
        detail=found.on_rendered("median", median).removeprefix("; "),
        figure="visits",
    )


def meaning(found: VisitsFound) -> Claim:
    per_pixel = [mm for scene in found.scenes for mm in scene.per_pixel]
    return Claim(
        "4 mm are fine: one pixel of noise in each marker coordinate displaces the tool by less, "
        "median of the poses",
        "showing",
        median(per_pixel),
        "mm",
        "<=",
        PAPER,
        found.settings.seeds,
        follows=True,
        detail=f"from {min(per_pixel):.1f} to {max(per_pixel):.1f} mm per pixel, by the true "
        "Jacobian",
        trap="T17",
        confirmed=median(per_pixel) > 1.0,
    )


def _figures(settings: Settings, results: Results) -> list[Shown]:
    seed = settings.seeds[0]
    panels = [_over_time(method, f"{method}-{seed}", results) for method in PAPER_METHODS]
    caption = "‖Δp‖ = ‖p₂ − p_d‖, by the truth; every jump is the next pose; shaded: exploration."
    return [
        *(shown for method in PAPER_METHODS for shown in _snapshots(method, settings, results)),
        Shown("pose-error", "Fig. 14", caption, [seed], Figure("Pose error", panels)),
        _visits(settings, results),
    ]


def _snapshots(method: str, settings: Settings, results: Results) -> list[Shown]:
    seed = settings.seeds[0]
    folder = results.folder(f"{method}-{seed}")
    pictures = sorted(folder.glob("snapshot-*.png"))
    if not pictures:
        return []
    caption = (
        f"Snapshots ({method}): first all poses that were shown, in black, then the end of each "
        "visit of the first round, features in blue upon the target in black."
    )
    return [Shown(f"snapshots-{method}", "Fig. 13", caption, [seed], pictures=pictures)]


def _over_time(method: str, task: str, results: Results) -> Panel:
    rows, visits = recorded(results.folder(task)), results.of(Visits, task)
    error = np.full(len(rows.time), np.nan)
    for visit in visits.made:
        during = (rows.time >= visit.began) & (rows.time <= visit.ended)
        away = rows.truth["p2"][during] - visits.poses[visit.pose]
        error[during] = np.linalg.norm(away, axis=1)
    new = rows.new_frames()
    return Panel(
        "time [s]",
        f"$\\|\\Delta p\\|$ [mm]\n{method}",
        [curve("", rows.time[new], error[new])],
        levels=[("4 mm", PAPER)],
        shaded=plots.exploration(rows),
        log_y=True,
    )


def _visits(settings: Settings, results: Results) -> Shown:
    names = [
        f"seed {seed}" + (" (rendered)" if seed in settings.rendered else "")
        for seed in settings.seeds
    ]
    scenes = [results.all(Visits, method, settings.seeds) for method in PAPER_METHODS]

    def panel(name: str, level: tuple[str, float], of: Callable[[Visit], float]) -> Panel:
        curves = [_marks(style, scenes[style], of) for style in range(len(scenes))]
        return Panel("", name, curves, levels=[level], log_y=True, categories=names)

    panels = [
        panel("$\\|\\Delta p\\|$ [mm]", ("4 mm", PAPER), lambda visit: visit.pose_error),
        panel("$\\|\\hat J - J\\| / \\|J\\|$", ("30 %", 0.3), lambda visit: visit.jacobian_error),
    ]
    caption = "Every visit's end: pose error, and the scaled error of Ĵ."
    figure = Figure("Ends of all visits", panels)
    return Shown("visits", "Fig. 14", caption, settings.seeds, figure)


def _marks(style: int, scenes: Sequence[Visits], of: Callable[[Visit], float]) -> Curve:
    """One mark for each visit, beside the place of its scene."""
    points = [
        (place + 0.3 * (style - 0.5), of(visit))
        for place, scene in enumerate(scenes)
        for visit in scene.made
    ]
    x, y = [x for x, _ in points], [y for _, y in points]
    return curve(list(PAPER_METHODS)[style], x, y, style, marks=True)


EXPERIMENT = Experiment(
    name="showing",
    title="Learning by showing",
    about="Fig. 13 and 14: six poses shown once and visited three times each, at the paper's "
    "gains, with both estimators (the paper shows the flow-based one).",
    whole=Settings(),
    quick=Settings(rendered=(), points=(0,), rounds=1, poses=2),
    tasks=tasks,
    chapter=chapter,
)
