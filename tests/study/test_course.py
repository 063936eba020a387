"""What a row tells of a run is what the run did, by the truth of its scene."""

from dataclasses import replace

import numpy as np
import pytest
from studies import small

from rcmservo.geometry.features import SCALE
from rcmservo.safety.causes import Cause
from rcmservo.safety.state_machine import PHASES, Phase
from rcmservo.sim.ground_truth import compute_feature_jacobian
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm
from rcmservo.study.batch import Study
from rcmservo.study.execution.chunk import one_run
from rcmservo.study.plan.cell import Cell
from rcmservo.study.row import NEVER, StudyRow, row_of
from rcmservo.study.run_outcome import StudyRun
from rcmservo.study.simulation_engine import Laboratory
from rcmservo.tracking import MarkerAppearance

S, A, H = Phase.SERVO, Phase.ACQUIRE, Phase.HOLD
QUIET, SAID = Cause.NONE, Cause.STALE


def course(errors: list[float], phases: list[Phase], causes: list[Cause] | None = None) -> StudyRun:
    """A run of these ticks, at 10 ticks a second, in any scene."""
    places = np.array([PHASES.index(phase) for phase in phases], np.int8)
    said = np.array([cause.place for cause in causes or [QUIET] * len(errors)], np.int8)
    return StudyRun(0, 10.0, np.array(errors), places, said, 0.1, scene_of(small().cells[0], 0))


def scene_of(cell: Cell, seed: int) -> Scene:
    engine = cell.engine_for(seed, cell.rebuilt({}))
    assert isinstance(engine, Study)
    return engine.run(seed).scene


def row(seed: int, **choices: object) -> tuple[StudyRow, Scene]:
    cell = small(count=1, methods=("dlt",), **choices).cells[0]
    return one_run(cell, cell.rebuilt({}), seed), scene_of(cell, seed)


@pytest.mark.parametrize(
    ("errors", "phases", "causes", "grown"),
    [
        ([5.0, 4.0, 6.0, 3.0], [S] * 4, None, 2.0),
        ([5.0, 4.0, 3.0], [S] * 3, None, 0.0),
        ([5.0, 4.0, 6.0, 3.0], [A] * 4, None, 0.0),
        ([5.0, 4.0, 6.0], [S] * 3, [QUIET, QUIET, SAID], 0.0),
        ([5.0, 4.0, 7.0, 6.5], [S] * 4, [QUIET, QUIET, SAID, QUIET], 2.5),
        ([5.0, 1.0, 8.0, 8.0, 8.5], [S, S, H, S, S], None, 0.5),
        ([1.0, 3.0, 3.5], [A, S, S], None, 0.5),
    ],
    ids=["beyond its least", "nearer", "not servoing", "with a word", "after it", "anew", "before"],
)
def test_unnoticed_is_what_the_error_grows_by_while_it_servoes_without_a_word(
    errors: list[float], phases: list[Phase], causes: list[Cause] | None, grown: float
) -> None:
    assert course(errors, phases, causes).unnoticed == grown


def test_the_pose_error_is_the_root_mean_square_of_the_last_second() -> None:
    """Ten ticks here: what was before does not count, and a mean would be smaller."""
    run = course([50.0] * 7 + [3.0, 4.0] * 5, [S] * 17)
    assert run.pose_error == pytest.approx(np.sqrt((9.0 + 16.0) / 2.0))


def test_first_within_is_the_first_time_whatever_follows() -> None:
    run = course([3.0, 1.0, 2.0, 0.5], [S] * 4)
    times = [run.first_within(mm) for mm in (1.0, 0.9, 0.4, 5.0)]
    assert times == [0.1, 0.3, np.inf, 0.0]


def test_a_row_of_a_run_that_never_came_near_knows_no_time_and_no_success() -> None:
    asked, settings = small().cells[0], small().scenes[0].fixed[1]
    far = row_of(asked, settings, course([30.0] * 20, [S] * 20))
    assert (far.success, far.time_to_1mm_s, far.stop, far.stop_s, far.stops) == (
        *(False, None, "", None, 0),
    )
    stopped = row_of(asked, settings, course([30.0] * 9 + [0.9] * 11, [S] * 9 + [H] * 11))
    assert (stopped.success, stopped.time_to_1mm_s, stopped.stop_s, stopped.stops) == (
        *(True, 0.9, 0.9, 1),
    )
    held = row_of(asked, settings, course([30.0] * 20, [S] * 9 + [H] * 11, [SAID] * 20))
    assert [str(one.result) for one in (far, stopped, held)] == [
        "not arrived: marker 2 is more than 1 mm from the target, error 30.00 mm (bound 0.10)",
        "arrived, error 0.90 mm (bound 0.10), 0.9 s",
        f"not arrived: {SAID.value}, error 30.00 mm (bound 0.10)",
    ]


def test_a_run_that_never_began_says_so() -> None:
    """As where frames are older than `thresholds.latency`: there is no stop to be told."""
    never = row(0, latency=(0.2,))[0]
    assert (never.stop, never.result.cause) == (NEVER, "it never began")
    assert row(0, latency=(0.05,))[0].stop == ""


def test_a_target_that_cannot_be_taught_ends_its_run_and_not_the_study() -> None:
    """By a tracker that looks for other balls."""
    cell = small(duration=1.1, shown=1, engine="pictures", methods=("dlt",)).cells[0]
    engine = cell.engine_for(0, cell.rebuilt({}))
    assert isinstance(engine, Laboratory)
    run = replace(engine, look=MarkerAppearance("magenta", "cyan")).run(0)
    assert not run.began and not run.stops
    assert run.error == pytest.approx(np.full(110, run.pose_error))
    assert run.pose_error == pytest.approx(row(0)[0].start_error_mm, rel=1e-3)


def test_the_balls_of_an_endoscopes_scenes_are_seen_in_pictures() -> None:
    """On a shaft that is thicker than they are they would not be."""
    choices = {"duration": 1.1, "shown": 1, "engine": "pictures", "scenes": ("laparoscopic",)}
    cell = small(methods=("dlt",), **choices).cells[0]
    assert cell.engine_for(0, cell.rebuilt({})).run(0).began


@pytest.mark.parametrize("scenes", ["random", "hard", "laparoscopic"])
def test_the_condition_is_the_largest_of_the_true_scaled_jacobian_on_the_way(scenes: str) -> None:
    told, scene = row(3, scenes=(scenes,))
    assert np.allclose([scene.path[0], scene.path[-1]], [scene.start, scene.target], atol=1e-9)
    o_c = compute_imaged_rcm(scene.optics)
    J = [compute_feature_jacobian(scene.body, scene.optics, q, o_c) for q in scene.path]
    scaled = [one / np.array(SCALE)[:, None] for one in J]
    most = max(np.linalg.cond(one) if np.isfinite(one).all() else np.inf for one in scaled)
    assert told.condition == pytest.approx(most, rel=1e-6)


def test_the_depth_of_the_rcm_is_negative_where_it_lies_behind_the_camera() -> None:
    behind = []
    for seed in range(12):
        told, scene = row(seed, scenes=("laparoscopic",), duration=1.1)
        ahead, place = scene.optics.rotation[2], scene.optics.position
        p1 = scene.body.points(scene.start)[0]
        assert told.rcm_depth == pytest.approx(-ahead @ place / (ahead @ (p1 - place)))
        assert told.distance_mm == pytest.approx(np.linalg.norm(p1 - place))
        behind.append(told.rcm_depth < 0.0)
    assert any(behind) and not all(behind)


def test_the_error_at_the_start_is_the_way_of_marker_2() -> None:
    told, scene = row(5)
    start, target = (scene.body.points(q)[1] for q in (scene.start, scene.target))
    assert told.start_error_mm == pytest.approx(np.linalg.norm(start - target), rel=1e-3)


def test_the_latency_is_that_of_the_frames_with_half_of_their_exposure() -> None:
    usual, asked = (row(0, **choices)[0] for choices in ({}, {"latency": (0.05,)}))
    timing = small().scenes[0].fixed[1].timing
    assert usual.latency_s == pytest.approx(0.5 * timing.exposure + timing.delay)
    assert asked.latency_s == pytest.approx(0.05)
    cell = small(latency=(0.05,)).cells[0]
    study = cell.engine_for(0, cell.rebuilt({}))
    assert isinstance(study, Study)
    pace = study._twin(scene_of(cell, 0)).pace  # pyright: ignore[reportPrivateUsage]
    assert pace.late == 50_000_000


def test_the_noise_of_rendered_frames_is_not_known() -> None:
    settings, run = small().scenes[0].fixed[1], course([0.5] * 20, [S] * 20)
    told = [
        row_of(replace(small().cells[0], engine=engine), settings, run)
        for engine in ("mujoco", "pictures")
    ]
    assert [one.noise_px for one in told] == [0.3, None]
