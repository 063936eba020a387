"""Imaged RCM: exact from exact lines, accurate from noisy ones, unbiased after a slow motion."""

import numpy as np
import pytest
import scipy.linalg
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
    estimate_noise_variance,
    intersect_lines,
    solve_sums,
    store_line,
    sum_lines,
    update_imaged_rcm,
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


@given(seeds, st.floats(0.02, 3.0), st.integers(2, 50))
def test_exact_lines_give_the_exact_point_at_any_position(seed, spread, count):
    random = make_random(seed)
    o_c = random.uniform(-1500, 1500, 2)
    angles = random.uniform(-np.pi, np.pi) + spread * np.linspace(0, 1, count)
    solution = solve_sums(sum_lines(draw_lines(random, o_c, angles)))
    assert np.allclose(solution.o_c, o_c, rtol=0, atol=1e-6)


@given(seeds)
def test_exact_images_of_a_tool_give_the_point_of_lemma_1(seed):
    random = make_random(seed)
    positions = draw_tool_positions(random, 20)
    C = draw_calibration_matrix(random, positions)
    solution = solve_sums(sum_lines(make_observation_rows(C, positions)[:, 3:].copy()))
    error = np.linalg.norm(solution.o_c - extract_parameters(C)[1])
    assert error < 1e-7 * solution.condition


@given(seeds, st.integers(5, 30))
def test_the_noise_variance_is_the_smallest_generalised_eigenvalue(seed, count):
    """Compare a solution by a general routine, which solves M x = σ² C x."""
    lines = make_random(seed).uniform(0, 640, (count, 4))
    sums = sum_lines(lines)
    M, C = sums[:3], sums[3:6]
    variances, points = scipy.linalg.eigh(M, C)
    assert estimate_noise_variance(sums) == pytest.approx(variances[0], rel=1e-4)
    solution, nearest = solve_sums(sums), points[:2, 0] / points[2, 0] + lines[0, :2]
    assert np.allclose(solution.o_c, nearest, rtol=1e-3, atol=1e-2)
    assert solution.condition == pytest.approx(
        np.linalg.cond((M - variances[0] * C)[:2, :2]), rel=1e-2
    )


def test_lines_have_the_squared_marker_distance_as_weight():
    """Of two parallel lines, the one with twice the marker distance weighs four times as much."""
    lines = np.array([[0.0, 0, 10, 0], [0.0, 1, 20, 1], [0.0, 0, 0, 10]])
    M = sum_lines(lines)[:3]
    assert np.allclose(np.linalg.solve(M[:2, :2], -M[:2, 2]), [0, 0.8])


@pytest.mark.parametrize("count", [0, 1])
def test_one_line_is_not_observable(count):
    line = np.array([[1.0, 2, 30, 40]])
    for solution in (solve_sums(sum_lines(line[:count])), intersect_lines(line[:count])):
        assert np.isnan(solution.o_c).all() and np.isinf(solution.condition)
        assert np.isnan(solution.covariance).all()


def test_parallel_lines_and_coincident_markers_are_not_observable():
    parallel = np.array([[0.0, i, 50, i] for i in range(10)])
    coincident = np.array([[i, 3.0 * i, i, 3.0 * i] for i in range(10)])
    for lines in (parallel, coincident):
        for solution in (solve_sums(sum_lines(lines)), intersect_lines(lines)):
            assert np.isnan(solution.o_c).all() and np.isinf(solution.condition)


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_without_the_noise_terms_eq_16_is_biased_towards_the_tool(noise):
    """All lines of a narrow span: the bias of (16) does not fall with their number."""
    o_c, towards_tool = np.array([100.0, -50.0]), np.array([np.cos(0.3), np.sin(0.3)])
    printed, refined, distances = [], [], []
    for seed in range(100):
        random = make_random(seed)
        lines = draw_lines(random, o_c, 0.3 + random.uniform(-0.05, 0.05, 500), noise=noise)
        solution = solve_sums(sum_lines(lines))
        printed.append(intersect_lines(lines).o_c - o_c)
        refined.append(solution.o_c - o_c)
        distances.append(refined[-1] @ np.linalg.solve(solution.covariance, refined[-1]))
    bias = np.mean(printed, axis=0) @ towards_tool
    assert bias > 40 * noise**2
    assert abs(np.mean(refined, axis=0) @ towards_tool) < 0.05 * bias
    assert 88 <= np.sum(np.array(distances) < 5.99) <= 99  # the covariance covers 95 %


def test_over_a_long_slow_motion_only_the_last_50_lines_collapse_onto_the_tool():
    """At 1°/s and 60 frames/s, 50 frames of a motion over 40° contain less than 1°."""
    random = make_random(7)
    o_c = np.array([80.0, 400.0])
    lines = draw_lines(random, o_c, np.radians(np.arange(0, 40, 1 / 60)), noise=0.3)
    window, refined = intersect_lines(lines[-50:]), solve_sums(sum_lines(lines))
    assert np.linalg.norm(window.o_c - o_c) > 50
    assert np.linalg.norm(refined.o_c - o_c) < 0.5
    assert window.condition > 100 * refined.condition


def test_the_noise_of_few_lines_is_that_which_is_expected():
    """Two lines always meet in a point, whatever their noise."""
    lines = draw_lines(make_random(0), np.zeros(2), np.array([0.0, 0.01]), noise=0.3)
    solution = solve_sums(sum_lines(lines))
    assert not ImagedRcm().knows(solution, lines[0, :2])


@given(seeds)
def test_the_imaged_rcm_is_known_up_to_the_limit_of_its_deviation(seed):
    random = make_random(seed)
    lines = draw_lines(random, np.zeros(2), np.linspace(0, 0.2, 50), noise=0.3)
    solution, m1 = solve_sums(sum_lines(lines)), lines[-1, :2]
    deviation = np.sqrt(np.trace(solution.covariance)) / np.linalg.norm(m1 - solution.o_c)
    assert ImagedRcm(max_deviation=1.01 * deviation).knows(solution, m1)
    assert not ImagedRcm(max_deviation=0.99 * deviation).knows(solution, m1)


@given(seeds, st.integers(2, 6), st.sampled_from(["refined", "printed"]))
def test_memory_is_bounded_and_an_update_does_not_change_its_input(seed, size, fit):
    random = make_random(seed)
    settings = ImagedRcm(lines=size, fit=fit)
    memory, count = settings.init()
    lines = draw_lines(random, np.zeros(2), random.uniform(0, 1, 3 * size))
    for i, line in enumerate(lines):
        before, points = memory.copy(), line.reshape(2, 2)
        after, count, solution = update_imaged_rcm(memory, count, points, settings.printed)
        assert np.array_equal(memory, before)
        assert after.shape == before.shape
        assert count == (min(i + 1, size) if settings.printed else i + 1)
        memory = after
    expected = intersect_lines(lines[-size:]) if settings.printed else solve_sums(sum_lines(lines))
    for actual, value in zip(solution, expected, strict=True):
        np.testing.assert_array_equal(actual, value)


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
    solution = intersect_lines(lines)
    np.testing.assert_allclose(solution.o_c, expected, rtol=1e-6, atol=1e-6)
    assert solution.condition == pytest.approx(np.linalg.cond(n.T @ n), rel=1e-6)
    assert not np.allclose(solution.o_c, solve_sums(sum_lines(lines)).o_c, rtol=1e-12, atol=0)


@given(seeds, st.integers(2, 5), st.integers(1, 12))
def test_the_printed_fit_stores_the_last_lines_in_order(seed, size, count):
    lines = make_random(seed).uniform(0, 640, (count, 4))
    memory, stored = ImagedRcm(lines=size, fit="printed").init()
    for line in lines:
        stored = store_line(memory, stored, line.reshape(2, 2))
    assert np.array_equal(memory[:stored], lines[-size:])


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
        {"max_condition": 1.0},
        {"max_condition": np.nan},
        {"max_deviation": 0.0},
        {"fit": "other"},
    ],
)
def test_invalid_settings_are_refused(invalid):
    with pytest.raises(BadInput, match=next(iter(invalid))):
        ImagedRcm(**invalid)
