"""Experiment `showing`: teaching by showing, Fig. 13 and 14.

The operator brings the tool to each pose and registers the image. Then the servo visits the poses
in turn, with the paper's gains. The pose error ‖Δp‖ = ‖p₂ − p_d‖ at the end of a visit uses the
true positions; the paper presumably uses those computed from the joints.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.figures import plots
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.run import Tick
from rcmservo.paper.lab.closed_loop import (
    PAPER_METHODS,
    POINT_NOISE_PX,
    PRINTED_LAW,
    Arrived,
    ClosedLoop,
    closed_loop,
    make_servo,
    read_task_record,
)
from rcmservo.paper.plan import Measurement, ReportFigure, Results, Settings, Task, TaskResult
from rcmservo.paper.statistics import column, median
from rcmservo.safety.causes import Cause
from rcmservo.sim import Rig, RigSettings, SceneSettings

SHOWING_LABORATORY = RigSettings(scene=SceneSettings(room=18.0), point_noise=POINT_NOISE_PX)
PAPER_BOUND_MM = 4.0
"""Bound of the paper on the pose error."""
BORDER_PX = 25.0
"""Smallest distance (px) of a pose's markers from the border of the image."""


def fixed_settings() -> dict[str, object]:
    return {"methods": PAPER_METHODS, "controller": PRINTED_LAW, "laboratory": SHOWING_LABORATORY}


def tasks(settings: Settings) -> list[Task]:
    found, visits = list[Task](), settings.poses * settings.rounds
    for seeds, pictures, cost in ((settings.rendered, True, 35.0), (settings.points, False, 8.0)):
        for method in PAPER_METHODS:
            work = partial(visit_all, method=method, pictures=pictures, settings=settings)
            found += Task.per_seed(method, work, seeds, cost * visits, in_folder=True)
    return found


def all_seeds(settings: Settings) -> list[int]:
    return [*settings.rendered, *settings.points]


def visit_all(
    folder: Path, seed: int, method: str, pictures: bool, settings: Settings
) -> TaskResult:
    """Teach all poses, explore about the start, and visit the poses in turn.

    Returns the visits in order, the cause that ended the last one early, p_d (n, 3) in mm of each
    pose, and the sensitivity `pose_per_pixel` there.
    """
    servo = make_servo(SHOWING_LABORATORY, *PAPER_METHODS[method], PRINTED_LAW)
    with closed_loop(folder, seed, SHOWING_LABORATORY, pictures, servo) as loop:
        taught = [loop.teach(q) for q in drawn_poses(loop.rig, settings.poses, settings.spread)]
        targets = [target for target, _ in taught]
        loop.rig.move_to_start()
        tick = loop.explore(targets[0])
        loop.snapshot("snapshot-0.png", targets[0], tick.state, "after exploration", targets[1:])
        visits = list[TaskResult]()
        for count in range(settings.rounds * settings.poses):
            pose: int = count % settings.poses
            if not tick.state.explored or tick.state.cause.stop_sentence:
                break
            target, p_d = taught[pose]
            one, tick = visit(loop, tick, target, p_d, settings.longest)
            visits.append({"pose": pose, **one})
            if count < settings.poses:
                words = f"pose {pose + 1}: |dp| {one['pose_error']:.2f} mm"
                loop.snapshot(f"snapshot-{pose + 1}.png", targets[pose], tick.state, words)
        per_pixel = [pose_per_pixel(loop.rig, target.q) for target in targets]
    unexplored = "" if tick.state.explored else Cause.NOT_EXPLORED.value
    return {
        "visits": visits,
        "cause": tick.state.cause.stop_sentence or unexplored,
        "poses": np.array([p_d for _, p_d in taught]),
        "per_pixel": np.array(per_pixel),
    }


def visit(
    loop: ClosedLoop, tick: Tick, target: Target, p_d: Floats, longest: float
) -> tuple[TaskResult, Tick]:
    """Servo to one pose; return times (s), final pose error (mm) and scaled error of Ĵ."""
    began = loop.elapsed()
    tick = loop.last(target, longest, tick.state, done=Arrived())
    return {
        "began": began,
        "ended": loop.elapsed(),
        "pose_error": np.linalg.norm(loop.true_p2() - p_d),
        "jacobian_error": loop.rig.truth.tick_error(tick),
    }, tick


def drawn_poses(rig: Rig, count: int, spread: float) -> list[Floats]:
    """Return the joints (3,) of random visible poses within `spread` mm of the start."""
    random = np.random.default_rng(rig.seed)
    kinematics, size = rig.settings.mechanism, np.array([rig.settings.width, rig.settings.height])
    start = kinematics.position(rig.scene.start)
    poses: list[Floats] = []
    while len(poses) < count:
        offset = random.standard_normal(3)
        offset = spread * random.uniform(0.5, 1.0) * offset / np.linalg.norm(offset)
        q = kinematics.joints(start + offset)
        m = rig.truth.pixels(q)
        inside = (q > kinematics.limits.lower) & (q < kinematics.limits.upper)
        if inside.all() and ((m > BORDER_PX) & (m < size - BORDER_PX)).all():
            poses.append(q)
    return poses


def pose_per_pixel(rig: Rig, q: Floats) -> float:
    """Return the rms displacement (mm) of marker 1 at `q` for 1 px of noise in each coordinate."""
    o_c = rig.truth.imaged_rcm()
    noise = compute_features_jacobian(shift_to_rcm(rig.truth.pixels(q), o_c))
    return float(np.linalg.norm(np.linalg.solve(rig.truth.jacobian(q, o_c), noise)))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds = all_seeds(settings)
    found = {method: results.per_seed(method, seeds) for method in ("flow", "projection")}
    errors = {method: column(_visits(scenes), "pose_error") for method, scenes in found.items()}
    rendered = {
        method: column(_visits(scenes[: len(settings.rendered)]), "pose_error")
        for method, scenes in found.items()
    }
    for method, scenes in found.items():
        J, worst = column(_visits(scenes), "jacobian_error"), rendered[method].max(initial=0.0)
        yield Measurement(
            "within-4-mm",
            max(errors[method], default=np.nan),
            seeds,
            case=(f"{method}-based",),
            visits=len(J),
            scenes=len(scenes),
            middle=median(J),
            worst=max(J, default=np.nan),
            rendered_worst=f"; on rendered frames worst {worst:.2f} mm"
            if len(rendered[method])
            else "",
        )
    for method, scenes in found.items():
        planned = settings.poses * settings.rounds * len(seeds)
        causes = sorted({scene["cause"] for scene in scenes if scene["cause"]})
        completed = 100.0 * len(errors[method]) / planned
        words = "; ".join([f"{planned} planned", *causes])
        yield Measurement("all-made", completed, seeds, case=(f"{method}-based",), words=words)
    per_pixel = np.concatenate([scene["per_pixel"] for scene in found["flow"]])
    yield Measurement(
        "meaning",
        median(per_pixel),
        seeds,
        confirmed=median(per_pixel) > 1.0,
        low=per_pixel.min(),
        high=per_pixel.max(),
    )
    for method in found:
        middle = median(rendered[method])
        words = f"on rendered frames median {middle:.2f} mm" if len(rendered[method]) else ""
        case = (f"{method}-based",)
        yield Measurement("median-visit", median(errors[method]), seeds, case=case, words=words)


def _visits(scenes: list[TaskResult]) -> list[TaskResult]:
    return [one for scene in scenes for one in scene["visits"]]


def draw(settings: Settings, results: Results) -> Iterator[ReportFigure]:
    seed = all_seeds(settings)[0]
    for method in PAPER_METHODS:
        pictures = sorted(results.folders[f"{method}-{seed}"].glob("snapshot-*.png"))
        if pictures:
            name, words = f"snapshots-{method}", {"method": method}
            yield ReportFigure(name, [seed], pictures=pictures, words=words, key="snapshots")
    panels = [_over_time(method, f"{method}-{seed}", results) for method in PAPER_METHODS]
    yield ReportFigure("pose-error", [seed], Figure("Pose error", panels))
    names = [
        f"seed {seed}" + (" (rendered)" if seed in settings.rendered else "")
        for seed in all_seeds(settings)
    ]
    numbers = {
        "pose_error": ("$\\|\\Delta p\\|$ [mm]", ("4 mm", PAPER_BOUND_MM)),
        "jacobian_error": ("$\\|\\hat J - J\\| / \\|J\\|$", ("30 %", 0.3)),
    }
    panels = [
        Panel(
            "",
            label,
            [_marks(i, m, settings, results, key) for i, m in enumerate(PAPER_METHODS)],
            levels=[level],
            log_y=True,
            categories=names,
        )
        for key, (label, level) in numbers.items()
    ]
    yield ReportFigure("visits", all_seeds(settings), Figure("Final errors of all visits", panels))


def _over_time(method: str, task: str, results: Results) -> Panel:
    rows, found = read_task_record(results.folders[task]), results[task]
    error = np.full(len(rows.time), np.nan)
    for one in found["visits"]:
        during = (rows.time >= one["began"]) & (rows.time <= one["ended"])
        offset = rows.truth["p2"][during] - found["poses"][one["pose"]]
        error[during] = np.linalg.norm(offset, axis=1)
    new = rows.new_frames()
    return Panel(
        "time [s]",
        f"$\\|\\Delta p\\|$ [mm]\n{method}",
        [make_curve("", rows.time[new], error[new])],
        levels=[("4 mm", PAPER_BOUND_MM)],
        shaded=plots.exploration_spans(rows),
        log_y=True,
    )


def _marks(style: int, method: str, settings: Settings, results: Results, key: str) -> Curve:
    """Return one mark per visit, next to the axis position of its scene."""
    points = [
        (index + 0.3 * (style - 0.5), one[key])
        for index, scene in enumerate(results.per_seed(method, all_seeds(settings)))
        for one in scene["visits"]
    ]
    return make_curve(method, [x for x, _ in points], [y for _, y in points], style, marks=True)
