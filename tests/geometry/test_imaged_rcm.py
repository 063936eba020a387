"""The imaged RCM: exact from exact lines, near from noisy ones, not pulled onto the tool by a slow
motion.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import SHAFT, equations, observed, random_from, seeds, tool_positions, true_camera
from rcmservo.errors import BadInput
from rcmservo.estimation.flow_rule import update as flow_update
from rcmservo.estimation.projection_rule import ProjectionMemory, Rule
from rcmservo.estimation.projection_rule import update as projection_update
from rcmservo.geometry.features import about
from rcmservo.geometry.imaged_rcm import (
    ImagedRcm,
    condition_of,
    nearest_to_lines,
    normal_equations,
    remember,
    solve,
)
from rcmservo.geometry.projection import parameters


def lines_through(random, o_c, angles, noise=0.0):
    """Rows [m₁ m₂] of raw pixels on lines through o_c at these angles, markers 60-90 px apart."""
    way = np.column_stack([np.cos(angles), np.sin(angles)])
    near = random.uniform(150, 250, len(angles))[:, None]
    far = near + random.uniform(60, 90, len(angles))[:, None]
    return np.hstack([o_c + near * way, o_c + far * way]) + noise * random.standard_normal(
        (len(angles), 4)
    )


def fill(lines, settings=None):
    """What `remember` keeps of a stream of lines."""
    settings = settings or ImagedRcm()
    memory, count = settings.init()
    for line in lines:
        memory, count = remember(memory, count, line.reshape(2, 2), settings.printed)
    return memory, count


@given(seeds, st.integers(0, 8), st.floats(0.02, 3.0), st.integers(2, 50))
def test_exact_lines_give_the_exact_point_wherever_it_is(seed, refinements, spread, count):
    random = random_from(seed)
    o_c = random.uniform(-1500, 1500, 2)
    angles = random.uniform(-np.pi, np.pi) + spread * np.linspace(0, 1, count)
    found, _ = solve(lines_through(random, o_c, angles), count, refinements, False)
    assert np.allclose(found, o_c, rtol=0, atol=1e-6)


@given(seeds)
def test_the_real_picture_of_a_tool_gives_lemma_1s_point(seed):
    random = random_from(seed)
    places = tool_positions(random, 20)
    C = true_camera(random, places)
    found, condition = solve(observed(C, places)[:, 3:].copy(), 20, 5, False)
    assert np.linalg.norm(found - parameters(C)[1]) < 1e-7 * condition


@given(seeds, st.integers(2, 30))
def test_the_condition_is_that_of_the_weighted_matrix_of_16(seed, count):
    random = random_from(seed)
    lines = random.uniform(0, 640, (count, 4))
    N, _ = normal_equations(lines, count, False)
    assert condition_of(N) == pytest.approx(np.linalg.cond(N), rel=1e-4)
    assert nearest_to_lines(lines, count, False)[1] == condition_of(N)


def test_lines_weigh_the_square_of_the_markers_distance():
    """Of two pairs of crossing lines that disagree, the one with markers twice as far apart counts
    four times.
    """
    lines = np.array([[0.0, 0, 10, 0], [0.0, 1, 20, 1], [0.0, 0, 0, 10]])
    assert np.allclose(nearest_to_lines(lines, 3, False)[0], [0, 0.8])


@pytest.mark.parametrize("count", [0, 1])
def test_one_line_says_not_observable(count):
    found, condition = solve(np.array([[1.0, 2, 30, 40]]), count, 5, False)
    assert np.isnan(found).all() and np.isinf(condition)


def test_parallel_lines_and_coincident_markers_say_not_observable():
    parallel = np.array([[0.0, i, 50, i] for i in range(10)])
    coincident = np.array([[i, 3.0 * i, i, 3.0 * i] for i in range(10)])
    for lines in (parallel, coincident):
        found, condition = solve(lines, 10, 5, False)
        assert np.isnan(found).all() and np.isinf(condition)


def test_with_noise_the_bundle_is_nearer_than_16_alone():
    """(16) is pulled towards the tool by noise; a bundle of lines through one point is not."""
    o_c = np.array([100.0, -50.0])
    alone, refined = [], []
    for seed in range(60):
        random = random_from(seed)
        lines = lines_through(random, o_c, 0.3 + random.uniform(-0.04, 0.04, 50), noise=0.5)
        alone.append(solve(lines, 50, 0, False)[0] - o_c)
        refined.append(solve(lines, 50, 5, False)[0] - o_c)
    pull = np.mean(alone, axis=0) @ [np.cos(0.3), np.sin(0.3)]
    bias = np.mean(refined, axis=0) @ [np.cos(0.3), np.sin(0.3)]
    assert pull > 10
    assert abs(bias) < 0.3 * pull
    assert np.median(np.linalg.norm(refined, axis=1)) < 0.7 * np.median(
        np.linalg.norm(alone, axis=1)
    )


def test_over_a_long_slow_motion_the_last_50_lines_collapse_onto_the_tool_and_ours_do_not():
    """40 degrees at 1 degree per second and 60 frames per second: 50 frames hold less than one
    degree.
    """
    random = random_from(7)
    o_c = np.array([80.0, 400.0])
    lines = lines_through(random, o_c, np.radians(np.arange(0, 40, 1 / 60)), noise=0.3)
    window, window_condition = nearest_to_lines(lines[-50:].copy(), 50, False)
    memory, count = fill(lines)
    kept, condition = solve(memory, count, ImagedRcm().refinements, False)
    assert np.linalg.norm(window - o_c) > 50
    assert np.linalg.norm(kept - o_c) < 1.5
    assert window_condition > 100 * condition


def test_standing_still_for_long_does_not_wash_out_what_was_seen():
    random = random_from(3)
    o_c = np.array([300.0, 200.0])
    tour = lines_through(random, o_c, random.uniform(0.0, 0.3, 60), noise=0.3)
    still = lines_through(random, o_c, np.full(1500, 0.15), noise=0.3)
    memory, count = fill(np.vstack([tour, still]))
    found, condition = solve(memory, count, 5, False)
    assert condition < 3e2
    assert np.linalg.norm(found - o_c) < 3


@given(seeds, st.integers(2, 6), st.sampled_from(["refined", "printed"]))
def test_memory_is_bounded_and_a_step_leaves_the_state_before_it_alone(seed, size, fit):
    random = random_from(seed)
    settings = ImagedRcm(lines=size, fit=fit)
    memory, count = settings.init()
    for i, line in enumerate(lines_through(random, np.zeros(2), random.uniform(0, 1, 3 * size))):
        before = memory.copy()
        after, count = remember(memory, count, line.reshape(2, 2), settings.printed)
        assert np.array_equal(memory, before)
        assert count == min(i + 1, size)
        memory = after


@given(seeds, st.integers(3, 30))
def test_eq_16_as_printed_is_that_of_unit_normals(seed, count):
    """Written down once more, and solved by another way."""
    random = random_from(seed)
    o_c = random.uniform(-500, 500, 2)
    angles = random.uniform(-np.pi, np.pi) + np.linspace(0, 1, count)
    lines = lines_through(random, o_c, angles, noise=1.0)
    along = lines[:, 2:] - lines[:, :2]
    n = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    wanted = np.linalg.lstsq(n, np.sum(n * lines[:, :2], axis=1), rcond=None)[0]
    found, condition = solve(lines, count, 9, True)
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)
    assert condition == pytest.approx(np.linalg.cond(n.T @ n), rel=1e-6)
    assert not np.allclose(found, nearest_to_lines(lines, count, False)[0], rtol=1e-12, atol=0)


@given(seeds, st.integers(2, 5), st.integers(0, 12))
def test_as_printed_the_last_lines_stay_in_order(seed, size, count):
    lines = random_from(seed).uniform(0, 640, (count, 4))
    memory, kept = fill(lines, ImagedRcm(lines=size, fit="printed"))
    assert np.array_equal(memory[:kept], lines[-size:] if count else lines)


def test_of_one_line_too_many_the_one_that_says_least_goes():
    """Equally spaced angles and one more in the middle: the extremes stay."""
    random = random_from(0)
    angles = np.array([0.0, 0.5, 0.25, 0.26])
    rows = lines_through(random, np.zeros(2), angles)
    memory, count = fill(rows, ImagedRcm(lines=3))
    kept = {tuple(row) for row in memory[:count]}
    assert tuple(rows[0]) in kept and tuple(rows[1]) in kept


@given(seeds)
def test_when_the_imaged_rcm_moves_every_old_observation_follows_it(seed):
    """Estimators keep raw pixels: equations about a new o_c are those of pictures that had it from
    the beginning.
    """
    random = random_from(seed)
    places = tool_positions(random, 8)
    rows = observed(true_camera(random, places), places)
    shift = random.uniform(-200, 200, 2)
    moved = rows.copy()
    moved[:, 3:] += np.tile(shift, 2)
    o_c = random.uniform(-100, 700, 2)
    for got, wanted in zip(equations(moved, o_c + shift), equations(rows, o_c), strict=True):
        assert np.allclose(got, wanted, rtol=1e-9, atol=1e-6)


def test_a_move_of_the_imaged_rcm_is_taken_over_by_both_estimators_at_once():
    random = random_from(5)
    places = tool_positions(random, 12)
    C = true_camera(random, places)
    rows, (a, o_c) = observed(C, places), parameters(C)
    wrong = o_c + np.array([40.0, -25.0])
    memory = ProjectionMemory(np.zeros((21, 7)), 0, np.zeros(9))
    rule = Rule(20.0, 1e-7, True)
    for i, row in enumerate(rows):  # o_c is wrong until the last frame
        known = o_c if i == len(rows) - 1 else wrong
        points = row[3:].reshape(2, 2)
        memory = projection_update(memory, row[:3], points, known, 10.0, rule, SHAFT)
        a_hat = memory.a_hat
    assert np.allclose(a_hat, a, rtol=1e-4, atol=1e-6)

    points = rows[0, 3:].reshape(2, 2)
    still = flow_update(np.zeros((3, 3)), np.ones(3), points, points, wrong, 0.02, 10.0)
    assert not still.any()  # the same pixels about one o_c are no flow
    assert np.array_equal(about(points, wrong), (points - wrong).ravel())


@pytest.mark.parametrize(
    "wrong",
    [
        {"lines": 1},
        {"refinements": -1},
        {"max_condition": 1.0},
        {"max_condition": np.nan},
        {"fit": "other"},
    ],
)
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(BadInput, match=next(iter(wrong))):
        ImagedRcm(**wrong)
