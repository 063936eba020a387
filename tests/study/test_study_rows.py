"""Rows of a study: their columns agree with the run and the true scene."""

from dataclasses import replace

import numpy as np
import pytest
from studies import make_small_plan

from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.sim.ground_truth import compute_true_jacobian_at_joints
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm
from rcmservo.study.compiled_engine import CompiledEngine
from rcmservo.study.execution.chunk import run_seed
from rcmservo.study.plan.cell import Cell
from rcmservo.study.row import NEVER_BEGAN, StudyRow, make_row
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.simulation_engine import SimulationEngine
from rcmservo.tracking import MarkerAppearance

S, A, H = Phase.SERVO, Phase.ACQUIRE, Phase.HOLD
NO_CAUSE, CAUSE = Cause.NONE, Cause.STALE


def make_run(
    errors: list[float], phases: list[Phase], causes: list[Cause] | None = None
) -> StudyRun:
    """Return a run of these ticks, at 10 ticks per second, in an arbitrary scene."""
    phase_codes = np.array([PHASES.index(phase) for phase in phases], np.int8)
    cause_codes = [cause.code for cause in causes or [NO_CAUSE] * len(errors)]
    scene = sample_scene(make_small_plan().cells[0], 0)
    error = np.array(errors)
    return StudyRun(0, 10.0, error, phase_codes, np.array(cause_codes, np.int8), 0.1, scene)


def sample_scene(cell: Cell, seed: int) -> Scene:
    engine = cell.make_engine(seed, cell.rebuild_servo({}))
    assert isinstance(engine, CompiledEngine)
    return engine.run(seed).scene


def run_row(seed: int, **settings: object) -> tuple[StudyRow, Scene]:
    cell = make_small_plan(count=1, methods=("dlt",), **settings).cells[0]
    return run_seed(cell, cell.rebuild_servo({}), seed), sample_scene(cell, seed)


@pytest.mark.parametrize(
    ("errors", "phases", "causes", "growth"),
    [
        ([5.0, 4.0, 6.0, 3.0], [S] * 4, None, 2.0),
        ([5.0, 4.0, 3.0], [S] * 3, None, 0.0),
        ([5.0, 4.0, 6.0, 3.0], [A] * 4, None, 0.0),
        ([5.0, 4.0, 6.0], [S] * 3, [NO_CAUSE, NO_CAUSE, CAUSE], 0.0),
        ([5.0, 4.0, 7.0, 6.5], [S] * 4, [NO_CAUSE, NO_CAUSE, CAUSE, NO_CAUSE], 2.5),
        ([5.0, 1.0, 8.0, 8.0, 8.5], [S, S, H, S, S], None, 0.5),
        ([1.0, 3.0, 3.5], [A, S, S], None, 0.5),
    ],
    ids=[
        "growth beyond the smallest error",
        "decrease",
        "other phase",
        "with a cause",
        "after a cause",
        "after a stop",
        "before SERVO",
    ],
)
def test_unnoticed_growth_counts_only_in_servo_without_a_cause(
    errors: list[float], phases: list[Phase], causes: list[Cause] | None, growth: float
) -> None:
    assert make_run(errors, phases, causes).unnoticed == growth


def test_the_pose_error_is_the_root_mean_square_of_the_last_second() -> None:
    """The last second has ten ticks; earlier ticks do not count, and a mean would be smaller."""
    run = make_run([50.0] * 7 + [3.0, 4.0] * 5, [S] * 17)
    assert run.pose_error == pytest.approx(np.sqrt((9.0 + 16.0) / 2.0))


def test_first_within_ignores_later_errors() -> None:
    run = make_run([3.0, 1.0, 2.0, 0.5], [S] * 4)
    times = [run.first_within(mm) for mm in (1.0, 0.9, 0.4, 5.0)]
    assert times == [0.1, 0.3, np.inf, 0.0]


def test_a_run_without_arrival_has_neither_time_nor_success() -> None:
    cell, settings = make_small_plan().cells[0], make_small_plan().scenes[0].nominal[1]
    far = make_row(cell, settings, make_run([30.0] * 20, [S] * 20))
    assert (far.success, far.time_to_1mm_s, far.stop, far.stop_s, far.stops) == (
        *(False, None, "", None, 0),
    )
    stopped = make_row(cell, settings, make_run([30.0] * 9 + [0.9] * 11, [S] * 9 + [H] * 11))
    assert (stopped.success, stopped.time_to_1mm_s, stopped.stop_s, stopped.stops) == (
        *(True, 0.9, 0.9, 1),
    )
    held = make_row(cell, settings, make_run([30.0] * 20, [S] * 9 + [H] * 11, [CAUSE] * 20))
    assert [str(row.result) for row in (far, stopped, held)] == [
        "not arrived: marker 2 is more than 1 mm from the target, error 30.00 mm (bound 0.10)",
        "arrived, error 0.90 mm (bound 0.10), 0.9 s",
        f"not arrived: {CAUSE.value}, error 30.00 mm (bound 0.10)",
    ]


def test_a_run_that_never_began_is_marked() -> None:
    """Frames older than `thresholds.latency` prevent the start without a stop."""
    never = run_row(0, latency=(0.2,))[0]
    assert (never.stop, never.result.cause) == (NEVER_BEGAN, "it never began")
    assert run_row(0, latency=(0.05,))[0].stop == ""


def test_a_target_that_cannot_be_taught_ends_its_run_but_not_the_study() -> None:
    """The tracker searches for markers of other colours."""
    cell = make_small_plan(
        duration=1.1, teaching_frames=1, engine="pictures", methods=("dlt",)
    ).cells[0]
    engine = cell.make_engine(0, cell.rebuild_servo({}))
    assert isinstance(engine, SimulationEngine)
    run = replace(engine, appearance=MarkerAppearance("magenta", "cyan")).run(0)
    assert not run.began and not run.stops
    assert run.error == pytest.approx(np.full(110, run.pose_error))
    assert run.pose_error == pytest.approx(run_row(0)[0].start_error_mm, rel=1e-3)


def test_markers_are_visible_in_rendered_laparoscopic_scenes() -> None:
    """A shaft thicker than the markers would hide them."""
    settings = {
        "duration": 1.1,
        "teaching_frames": 1,
        "engine": "pictures",
        "scenes": ("laparoscopic",),
    }
    cell = make_small_plan(methods=("dlt",), **settings).cells[0]
    assert cell.make_engine(0, cell.rebuild_servo({})).run(0).began


@pytest.mark.parametrize("scenes", ["random", "hard", "laparoscopic"])
def test_the_condition_is_the_largest_of_the_true_scaled_jacobian_on_the_path(scenes: str) -> None:
    row, scene = run_row(3, scenes=(scenes,))
    assert np.allclose([scene.path[0], scene.path[-1]], [scene.start, scene.target], atol=1e-9)
    o_c = compute_imaged_rcm(scene.optics)
    J = [compute_true_jacobian_at_joints(scene.body, scene.optics, q, o_c) for q in scene.path]
    scaled = [matrix / np.array(FEATURE_SCALE)[:, None] for matrix in J]
    largest = max(np.linalg.cond(A) if np.isfinite(A).all() else np.inf for A in scaled)
    assert row.condition == pytest.approx(largest, rel=1e-6)


def test_the_depth_of_an_rcm_behind_the_camera_is_negative() -> None:
    behind = []
    for seed in range(12):
        row, scene = run_row(seed, scenes=("laparoscopic",), duration=1.1)
        axis, position = scene.optics.rotation[2], scene.optics.position
        p1 = scene.body.points(scene.start)[0]
        assert row.rcm_depth == pytest.approx(-axis @ position / (axis @ (p1 - position)))
        assert row.distance_mm == pytest.approx(np.linalg.norm(p1 - position))
        behind.append(row.rcm_depth < 0.0)
    assert any(behind) and not all(behind)


def test_the_initial_error_is_the_distance_of_marker_2_to_the_target() -> None:
    row, scene = run_row(5)
    start, target = (scene.body.points(q)[1] for q in (scene.start, scene.target))
    assert row.start_error_mm == pytest.approx(np.linalg.norm(start - target), rel=1e-3)


def test_the_latency_includes_half_of_the_exposure() -> None:
    default, requested = (run_row(0, **settings)[0] for settings in ({}, {"latency": (0.05,)}))
    timing = make_small_plan().scenes[0].nominal[1].timing
    assert default.latency_s == pytest.approx(0.5 * timing.exposure + timing.delay)
    assert requested.latency_s == pytest.approx(0.05)
    cell = make_small_plan(latency=(0.05,)).cells[0]
    study = cell.make_engine(0, cell.rebuild_servo({}))
    assert isinstance(study, CompiledEngine)
    plant = study._make_plant(0, sample_scene(cell, 0))  # pyright: ignore[reportPrivateUsage]
    assert plant.frame_timing.latency == 50_000_000


def test_the_noise_of_rendered_frames_is_unknown() -> None:
    settings, run = make_small_plan().scenes[0].nominal[1], make_run([0.5] * 20, [S] * 20)
    rows = [
        make_row(replace(make_small_plan().cells[0], engine=engine), settings, run)
        for engine in ("mujoco", "pictures")
    ]
    assert [row.noise_px for row in rows] == [0.3, None]
