"""Check of the paper's section IV-C, teaching by showing: Fig. 13 and 14.

Experiment `showing`. The operator brings the tool to each pose and registers the image. Then the
servo visits the poses in turn, with the paper's gains. The pose error ‖Δp‖ = ‖p₂ − p_d‖ at the end
of a visit uses the true positions; the paper presumably uses those computed from the joints.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from rcmservo.figures import plots
from rcmservo.figures.charts import Curve, Figure, Panel, make_curve
from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.interfaces import Floats, Target
from rcmservo.loop.servo_loop import Tick
from rcmservo.paper.lab.closed_loop import (
    Arrived,
    ClosedLoop,
    closed_loop,
    make_servo,
    read_task_record,
)
from rcmservo.paper.lab.paper_settings import (
    PAPER_MAX_POSE_ERROR_MM,
    PAPER_METHODS,
    POINT_NOISE_PX,
)
from rcmservo.paper.plan import Measurement, PaperFigure, Results, Settings, Task, TaskResult, Texts
from rcmservo.paper.statistics import column, median
from rcmservo.safety.causes import Cause
from rcmservo.sim import Rig, RigSettings, SceneSettings

LABORATORY = RigSettings(scene=SceneSettings(room=18.0), point_noise=POINT_NOISE_PX)
BORDER_PX = 25.0
"""Smallest distance (px) of a pose's markers from the border of the image."""
CASES = {"flow": ("flow-based",), "projection": ("projection-based",)}
"""Case in the table of claims of each method, the method of Fig. 13 first."""


def tasks(settings: Settings) -> list[Task]:
    """Return the tasks; the cost of a visit in s is larger on rendered frames."""
    all_tasks, visits = list[Task](), settings.poses * settings.rounds
    for seeds, is_rendered, cost in (
        (settings.rendered, True, 35.0),
        (settings.points, False, 8.0),
    ):
        work = partial(visit_all, is_rendered=is_rendered, settings=settings)
        for method in PAPER_METHODS:
            method_work = partial(work, method=method)
            all_tasks += Task.per_seed(method, method_work, seeds, cost * visits, in_folder=True)
    return all_tasks


def list_seeds(settings: Settings) -> list[int]:
    """Return all seeds, those on rendered frames first."""
    return [*settings.rendered, *settings.points]


def visit_all(
    folder: Path, seed: int, method: str, is_rendered: bool, settings: Settings
) -> TaskResult:
    """Teach all poses, explore about the start, and visit the poses in turn.

    The result holds the visits in order, the cause that ended the last one early, the true position
    p_d (n, 3) of marker 2 at each taught pose in mm, and `compute_pose_error_per_pixel` there.
    """
    servo = make_servo(LABORATORY, *PAPER_METHODS[method])
    with closed_loop(folder, seed, LABORATORY, is_rendered, servo) as loop:
        poses = draw_poses(loop.rig, settings.poses, settings.spread)
        targets, p_d = zip(*(loop.teach(q) for q in poses), strict=True)
        loop.rig.go_home()
        tick = loop.explore(targets[0])
        state = tick.state
        loop.write_snapshot("snapshot-0.png", targets[0], state, "after exploration", targets[1:])
        visits = list[TaskResult]()
        for count in range(settings.rounds * settings.poses):
            pose: int = count % settings.poses
            if not tick.state.explored or tick.state.cause.stop_sentence:
                break
            result, tick = visit(loop, tick, targets[pose], p_d[pose], settings.longest)
            visits.append({"pose": pose, **result})
            if count < settings.poses:
                caption = f"pose {pose + 1}: |dp| {result['pose_error']:.2f} mm"
                name = f"snapshot-{pose + 1}.png"
                loop.write_snapshot(name, targets[pose], tick.state, caption)
        per_pixel = [compute_pose_error_per_pixel(loop.rig, target.q) for target in targets]
    unexplored = "" if tick.state.explored else Cause.NOT_EXPLORED.value
    cause = tick.state.cause.stop_sentence or unexplored
    return dict(visits=visits, cause=cause, poses=np.array(p_d), per_pixel=np.array(per_pixel))


def visit(
    loop: ClosedLoop, tick: Tick, target: Target, p_d: Floats, longest: float
) -> tuple[TaskResult, Tick]:
    """Servo to one pose; return times (s), final pose error (mm) and scaled error of Ĵ."""
    began = loop.elapsed()
    tick = loop.finish_stage(target, longest, tick.state, done=Arrived())
    return {
        "began": began,
        "ended": loop.elapsed(),
        "pose_error": np.linalg.norm(loop.true_p2() - p_d),
        "jacobian_error": loop.rig.truth.jacobian_error_at_tick(tick),
    }, tick


def draw_poses(rig: Rig, count: int, spread: float) -> list[Floats]:
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
        is_within_limits = (q > kinematics.limits.lower) & (q < kinematics.limits.upper)
        is_visible = (m > BORDER_PX) & (m < size - BORDER_PX)
        if is_within_limits.all() and is_visible.all():
            poses.append(q)
    return poses


def compute_pose_error_per_pixel(rig: Rig, q: Floats) -> float:
    """Return the rms error (mm) of marker 1 that 1 px of noise in each coordinate causes at `q`."""
    o_c = rig.truth.imaged_rcm()
    noise = compute_features_jacobian(shift_to_rcm(rig.truth.pixels(q), o_c))
    return float(np.linalg.norm(np.linalg.solve(rig.truth.jacobian(q, o_c), noise)))


def measure(settings: Settings, results: Results) -> Iterator[Measurement]:
    seeds, rendered_count = list_seeds(settings), len(settings.rendered)
    scenes = {method: results.per_seed(method, seeds) for method in CASES}
    errors = {method: column(list_visits(scenes[method]), "pose_error") for method in CASES}
    rendered = {
        method: column(list_visits(scenes[method][:rendered_count]), "pose_error")
        for method in CASES
    }
    for method, case in CASES.items():
        jacobian_errors = column(list_visits(scenes[method]), "jacobian_error")
        worst = f"; on rendered frames worst {rendered[method].max(initial=0.0):.2f} mm"
        yield Measurement(
            "within-4-mm",
            max(errors[method], default=np.nan),
            seeds,
            case=case,
            visits=len(jacobian_errors),
            scenes=len(scenes[method]),
            middle=median(jacobian_errors),
            worst=max(jacobian_errors, default=np.nan),
            rendered_worst=worst if len(rendered[method]) else "",
        )
    for method, case in CASES.items():
        planned = settings.poses * settings.rounds * len(seeds)
        causes = sorted({scene["cause"] for scene in scenes[method] if scene["cause"]})
        completed = 100.0 * len(errors[method]) / planned
        summary = "; ".join([f"{planned} planned", *causes])
        yield Measurement("all-made", completed, seeds, case=case, summary=summary)
    per_pixel = np.concatenate([scene["per_pixel"] for scene in scenes["flow"]])
    value, ends = median(per_pixel), Texts(low=per_pixel.min(), high=per_pixel.max())
    yield Measurement("meaning", value, seeds, confirmed=value > 1.0, **ends)
    for method, case in CASES.items():
        summary = f"on rendered frames median {median(rendered[method]):.2f} mm"
        summary = summary if len(rendered[method]) else ""
        yield Measurement("median-visit", median(errors[method]), seeds, case=case, summary=summary)


def list_visits(scenes: list[TaskResult]) -> list[TaskResult]:
    return [visit for scene in scenes for visit in scene["visits"]]


def draw(settings: Settings, results: Results) -> Iterator[PaperFigure]:
    seeds = list_seeds(settings)
    for method in PAPER_METHODS:
        pictures = sorted(results.folders[f"{method}-{seeds[0]}"].glob("snapshot-*.png"))
        if pictures:
            name, texts = f"snapshots-{method}", {"method": method}
            yield PaperFigure(name, seeds[:1], pictures=pictures, texts=texts, key="snapshots")
    panels = [draw_pose_error(method, f"{method}-{seeds[0]}", results) for method in PAPER_METHODS]
    yield PaperFigure("pose-error", seeds[:1], Figure("Pose error", panels))
    names = [f"seed {i}" + (" (rendered)" if i in settings.rendered else "") for i in seeds]
    pose_level, jacobian_level = ("4 mm", PAPER_MAX_POSE_ERROR_MM), ("30 %", 0.3)
    panels = list[Panel]()
    for key, label, level in (
        ("pose_error", "$\\|\\Delta p\\|$ [mm]", pose_level),
        ("jacobian_error", "$\\|\\hat J - J\\| / \\|J\\|$", jacobian_level),
    ):
        curves = list[Curve]()
        for style, method in enumerate(PAPER_METHODS):
            scenes = results.per_seed(method, seeds)
            counts = [len(one["visits"]) for one in scenes]
            errors = column(list_visits(scenes), key)
            x = np.repeat(np.arange(len(scenes)), counts) + 0.3 * (style - 0.5)
            curves.append(make_curve(method, x, errors, style, marks=True))
        panels.append(Panel("", label, curves, levels=[level], log_y=True, categories=names))
    yield PaperFigure("visits", seeds, Figure("Final errors of all visits", panels))


def draw_pose_error(method: str, task: str, results: Results) -> Panel:
    """Return the pose error over time of all visits of one task."""
    record, result = read_task_record(results.folders[task]), results[task]
    error = np.full(len(record.time), np.nan)
    for one in result["visits"]:
        during = (record.time >= one["began"]) & (record.time <= one["ended"])
        offset = record.truth["p2"][during] - result["poses"][one["pose"]]
        error[during] = np.linalg.norm(offset, axis=1)
    new = record.new_frames()
    return Panel(
        "time [s]",
        f"$\\|\\Delta p\\|$ [mm]\n{method}",
        [make_curve("", record.time[new], error[new])],
        levels=[("4 mm", PAPER_MAX_POSE_ERROR_MM)],
        shaded=plots.find_exploration_spans(record),
        log_y=True,
    )
