"""Imaged RCM: exact from exact lines, accurate from noisy ones, unbiased after a slow motion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import (
    SHAFT,
    build_equations,
    draw_calibration_matrix,
    draw_tool_positions,
    make_observation_rows,
    make_random,
    seeds,
)
from rcmservo.errors import BadInput
from rcmservo.estimation.displacement import measure_displacement
from rcmservo.estimation.projection_rule import ProjectionKernel, ProjectionMemory
from rcmservo.estimation.projection_rule import update_from_frame as projection_update
from rcmservo.geometry.features import shift_to_rcm
from rcmservo.geometry.imaged_rcm import (
    ImagedRcm,
    build_normal_equations,
    compute_condition,
    intersect_lines,
    solve_imaged_rcm,
    store_line,
)
from rcmservo.geometry.projection import extract_parameters


def draw_lines(random, o_c, angles, noise=0.0):
    """Return rows [m₁ m₂] of raw pixels on lines through o_c, with markers 60-90 px apart."""
    direction = np.column_stack([np.cos(angles), np.sin(angles)])
    near = random.uniform(150, 250, len(angles))[:, None]
    far = near + random.uniform(60, 90, len(angles))[:, None]
    return np.hstack(
        [o_c + near * direction, o_c + far * direction]
    ) + noise * random.standard_normal((len(angles), 4))


def store_lines(lines, settings=None):
    """Return the lines that are stored of a stream of lines, and their number."""
    settings = settings or ImagedRcm()
    memory, count = settings.init()
    for line in lines:
        memory, count = store_line(memory, count, line.reshape(2, 2), settings.printed)
    return memory, count


@given(seeds, st.integers(0, 8), st.floats(0.02, 3.0), st.integers(2, 50))
def test_exact_lines_give_the_exact_point_at_any_position(seed, refinements, spread, count):
    random = make_random(seed)
    o_c = random.uniform(-1500, 1500, 2)
    angles = random.uniform(-np.pi, np.pi) + spread * np.linspace(0, 1, count)
    estimated_o_c, _ = solve_imaged_rcm(draw_lines(random, o_c, angles), count, refinements, False)
    assert np.allclose(estimated_o_c, o_c, rtol=0, atol=1e-6)


@given(seeds)
def test_exact_images_of_a_tool_give_the_point_of_lemma_1(seed):
    random = make_random(seed)
    positions = draw_tool_positions(random, 20)
    C = draw_calibration_matrix(random, positions)
    estimated_o_c, condition = solve_imaged_rcm(
        make_observation_rows(C, positions)[:, 3:].copy(), 20, 5, False
    )
    assert np.linalg.norm(estimated_o_c - extract_parameters(C)[1]) < 1e-7 * condition


@given(seeds, st.integers(2, 30))
def test_the_condition_is_that_of_the_weighted_matrix_of_16(seed, count):
    random = make_random(seed)
    lines = random.uniform(0, 640, (count, 4))
    N, _ = build_normal_equations(lines, count, False)
    assert compute_condition(N) == pytest.approx(np.linalg.cond(N), rel=1e-4)
    assert intersect_lines(lines, count, False)[1] == compute_condition(N)


def test_lines_have_the_squared_marker_distance_as_weight():
    """Of two parallel lines, the one with twice the marker distance weighs four times as much."""
    lines = np.array([[0.0, 0, 10, 0], [0.0, 1, 20, 1], [0.0, 0, 0, 10]])
    assert np.allclose(intersect_lines(lines, 3, False)[0], [0, 0.8])


@pytest.mark.parametrize("count", [0, 1])
def test_one_line_is_not_observable(count):
    estimated_o_c, condition = solve_imaged_rcm(np.array([[1.0, 2, 30, 40]]), count, 5, False)
    assert np.isnan(estimated_o_c).all() and np.isinf(condition)


def test_parallel_lines_and_coincident_markers_are_not_observable():
    parallel = np.array([[0.0, i, 50, i] for i in range(10)])
    coincident = np.array([[i, 3.0 * i, i, 3.0 * i] for i in range(10)])
    for lines in (parallel, coincident):
        estimated_o_c, condition = solve_imaged_rcm(lines, 10, 5, False)
        assert np.isnan(estimated_o_c).all() and np.isinf(condition)


def test_with_noise_the_bundle_is_more_accurate_than_eq_16_alone():
    """Noise biases (16) towards the tool, but not a bundle of lines through one point."""
    o_c = np.array([100.0, -50.0])
    alone, refined = [], []
    for seed in range(60):
        random = make_random(seed)
        lines = draw_lines(random, o_c, 0.3 + random.uniform(-0.04, 0.04, 50), noise=0.5)
        alone.append(solve_imaged_rcm(lines, 50, 0, False)[0] - o_c)
        refined.append(solve_imaged_rcm(lines, 50, 5, False)[0] - o_c)
    pull = np.mean(alone, axis=0) @ [np.cos(0.3), np.sin(0.3)]
    bias = np.mean(refined, axis=0) @ [np.cos(0.3), np.sin(0.3)]
    assert pull > 10
    assert abs(bias) < 0.3 * pull
    assert np.median(np.linalg.norm(refined, axis=1)) < 0.7 * np.median(
        np.linalg.norm(alone, axis=1)
    )


def test_over_a_long_slow_motion_only_the_last_50_lines_collapse_onto_the_tool():
    """At 1°/s and 60 frames/s, 50 frames of a motion over 40° contain less than 1°."""
    random = make_random(7)
    o_c = np.array([80.0, 400.0])
    lines = draw_lines(random, o_c, np.radians(np.arange(0, 40, 1 / 60)), noise=0.3)
    window, window_condition = intersect_lines(lines[-50:].copy(), 50, False)
    memory, count = store_lines(lines)
    informative, condition = solve_imaged_rcm(memory, count, ImagedRcm().refinements, False)
    assert np.linalg.norm(window - o_c) > 50
    assert np.linalg.norm(informative - o_c) < 1.5
    assert window_condition > 100 * condition


def test_a_long_standstill_does_not_displace_informative_lines():
    random = make_random(3)
    o_c = np.array([300.0, 200.0])
    exploration = draw_lines(random, o_c, random.uniform(0.0, 0.3, 60), noise=0.3)
    standstill = draw_lines(random, o_c, np.full(1500, 0.15), noise=0.3)
    memory, count = store_lines(np.vstack([exploration, standstill]))
    estimated_o_c, condition = solve_imaged_rcm(memory, count, 5, False)
    assert condition < 3e2
    assert np.linalg.norm(estimated_o_c - o_c) < 3


@given(seeds, st.integers(2, 6), st.sampled_from(["refined", "printed"]))
def test_memory_is_bounded_and_an_update_does_not_change_its_input(seed, size, fit):
    random = make_random(seed)
    settings = ImagedRcm(lines=size, fit=fit)
    memory, count = settings.init()
    for i, line in enumerate(draw_lines(random, np.zeros(2), random.uniform(0, 1, 3 * size))):
        before = memory.copy()
        after, count = store_line(memory, count, line.reshape(2, 2), settings.printed)
        assert np.array_equal(memory, before)
        assert count == min(i + 1, size)
        memory = after


@given(seeds, st.integers(3, 30))
def test_eq_16_as_printed_uses_unit_normals(seed, count):
    """Compare eq. (16), written a second time and solved by least squares."""
    random = make_random(seed)
    o_c = random.uniform(-500, 500, 2)
    angles = random.uniform(-np.pi, np.pi) + np.linspace(0, 1, count)
    lines = draw_lines(random, o_c, angles, noise=1.0)
    along = lines[:, 2:] - lines[:, :2]
    n = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    expected = np.linalg.lstsq(n, np.sum(n * lines[:, :2], axis=1), rcond=None)[0]
    estimated_o_c, condition = solve_imaged_rcm(lines, count, 9, True)
    np.testing.assert_allclose(estimated_o_c, expected, rtol=1e-6, atol=1e-6)
    assert condition == pytest.approx(np.linalg.cond(n.T @ n), rel=1e-6)
    assert not np.allclose(
        estimated_o_c, intersect_lines(lines, count, False)[0], rtol=1e-12, atol=0
    )


@given(seeds, st.integers(2, 5), st.integers(0, 12))
def test_the_printed_fit_stores_the_last_lines_in_order(seed, size, count):
    lines = make_random(seed).uniform(0, 640, (count, 4))
    memory, stored = store_lines(lines, ImagedRcm(lines=size, fit="printed"))
    assert np.array_equal(memory[:stored], lines[-size:] if count else lines)


def test_the_least_informative_line_is_removed():
    """Of equally spaced angles and one more in the middle, the extremes stay."""
    random = make_random(0)
    angles = np.array([0.0, 0.5, 0.25, 0.26])
    rows = draw_lines(random, np.zeros(2), angles)
    memory, count = store_lines(rows, ImagedRcm(lines=3))
    stored = {tuple(row) for row in memory[:count]}
    assert tuple(rows[0]) in stored and tuple(rows[1]) in stored


@given(seeds)
def test_stored_observations_follow_a_new_imaged_rcm(seed):
    """Raw pixels are stored, so all equations are about the newest o_c."""
    random = make_random(seed)
    positions = draw_tool_positions(random, 8)
    rows = make_observation_rows(draw_calibration_matrix(random, positions), positions)
    shift = random.uniform(-200, 200, 2)
    shifted_rows = rows.copy()
    shifted_rows[:, 3:] += np.tile(shift, 2)
    o_c = random.uniform(-100, 700, 2)
    for actual, expected in zip(
        build_equations(shifted_rows, o_c + shift), build_equations(rows, o_c), strict=True
    ):
        assert np.allclose(actual, expected, rtol=1e-9, atol=1e-6)


def test_both_estimators_use_a_new_imaged_rcm_at_once():
    random = make_random(5)
    positions = draw_tool_positions(random, 12)
    C = draw_calibration_matrix(random, positions)
    rows, (a, o_c) = make_observation_rows(C, positions), extract_parameters(C)
    deviating_o_c = o_c + np.array([40.0, -25.0])
    memory = ProjectionMemory(np.zeros((21, 7)), 0, np.zeros(9))
    rule = ProjectionKernel(20.0, 1e-7, True)
    for i, row in enumerate(rows):  # o_c deviates until the last frame
        current_o_c = o_c if i == len(rows) - 1 else deviating_o_c
        points = row[3:].reshape(2, 2)
        memory = projection_update(memory, row[:3], points, current_o_c, 10.0, rule, SHAFT)
        a_hat = memory.a_hat
    assert np.allclose(a_hat, a, rtol=1e-4, atol=1e-6)

    points = rows[0, 3:].reshape(2, 2)
    _, delta_y = measure_displacement(np.zeros(3), points, np.ones(3), points, deviating_o_c)
    assert not delta_y.any()  # the same pixels about one o_c are no motion
    assert np.array_equal(shift_to_rcm(points, deviating_o_c), (points - deviating_o_c).ravel())


@pytest.mark.parametrize(
    "invalid",
    [
        {"lines": 1},
        {"refinements": -1},
        {"max_condition": 1.0},
        {"max_condition": np.nan},
        {"fit": "other"},
    ],
)
def test_invalid_settings_are_refused(invalid):
    with pytest.raises(BadInput, match=next(iter(invalid))):
        ImagedRcm(**invalid)
