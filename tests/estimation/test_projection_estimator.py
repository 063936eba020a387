"""Proposition 1 and its implementation: U never rises, exact integration, decay rates, Ĵ → J."""

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.linalg import expm

from conftest import (
    SHAFT,
    TOOLS,
    build_equations,
    differentiate,
    draw_calibration_matrix,
    draw_tool_positions,
    make_observation_rows,
    make_random,
    project_markers,
    seeds,
)
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Sample
from rcmservo.estimation.projection_rule import (
    GAMMA_0,
    MIN_DEPTH,
    ProjectionEstimator,
    ProjectionKernel,
    ProjectionMemory,
    collect_fitted_points,
    compute_estimated_jacobian,
    compute_inverse_root,
    find_least_informative_observation,
    limit_step_by_depth,
    update_from_frame,
)
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    compute_feature_error,
    compute_features,
    shift_to_rcm,
)
from rcmservo.geometry.projection import build_regressor, compute_depth, extract_parameters
from rcmservo.geometry.tool import compute_second_marker
from rcmservo.numerics.gradient_flow import (
    integrate_by_eigenvectors,
    integrate_by_series,
    integrate_gradient_flow,
)

times = st.one_of(st.floats(1e-4, 1e-1), st.floats(1e-1, 1e3), st.sampled_from([1e-9, 1e4]))
modes = st.booleans()
EPSILON = ProjectionEstimator().epsilon


def scene(seed, count=12):
    """Return exact observations, the true parameters a, the imaged RCM o_c, and an estimate.

    The estimate has all observations in front of the camera.
    """
    random = make_random(seed)
    positions = draw_tool_positions(random, count)
    C = draw_calibration_matrix(random, positions)
    a, o_c = extract_parameters(C)
    a_hat = np.where(random.random() < 0.5, 0.0, a * random.uniform(0.6, 1.4, 9))
    return make_observation_rows(C, positions), a, o_c, a_hat


def step(memory, count, a_hat, row, o_c, t, rate=20.0, both=True):
    points = row[3:].reshape(2, 2)
    rule = ProjectionKernel(float(rate), EPSILON, bool(both))
    before = ProjectionMemory(memory, count, a_hat)
    return update_from_frame(before, row[:3], points, o_c, float(t), rule, SHAFT)


def energy(a_hat, a):
    """Return U of (22) with Γ₀."""
    return 0.5 * np.sum((a_hat - a) ** 2 / GAMMA_0)


def root_of(A, fast, rate=20.0):
    """Return C with C Cᵀ = Γ, as the update makes it."""
    if not fast:
        return np.diag(np.sqrt(GAMMA_0))
    return np.sqrt(rate) * compute_inverse_root(A, EPSILON)


def steepest_rise(seed, t, fast, both, room=8):
    """Return the largest rise of U between frames, as a fraction of U at â = 0.

    There are 20 exact images, and P = `room`.
    """
    rows, a, o_c, a_hat = scene(seed, count=20)
    memory, count, worst = np.zeros((room + 1, 7)), 0, 0.0
    for row in rows:
        before = energy(a_hat, a)
        memory, count, a_hat = step(memory, count, a_hat, row, o_c, t, 20.0 if fast else 0.0, both)
        worst = max(worst, (energy(a_hat, a) - before) / energy(0 * a, a))
    return worst


@given(seeds, times, st.booleans())
def test_proposition_1_u_never_rises_under_the_printed_gamma_even_as_observations_are_exchanged(
    seed, t, both
):
    assert steepest_rise(seed, t, False, both) < 1e-9


@given(seeds, times, st.booleans())
@example(1879503239, 1e3, True)
@example(30282166, 259.0, False)
def test_u_never_rises_under_the_fast_gamma_while_observations_are_added(seed, t, both):
    """½ΔaᵀΓ₀⁻¹Δa never rises, although Γ changes with every observation."""
    assert steepest_rise(seed, t, True, both, room=20) < 1e-9


@pytest.mark.parametrize("t", [1e-4, 1 / 60])
def test_u_never_rises_under_the_fast_gamma_as_observations_are_exchanged(t):
    assert (
        max(steepest_rise(seed, t, True, both) for seed in range(30) for both in (False, True))
        < 1e-9
    )


@given(seeds, times, st.booleans())
def test_u_with_gamma_itself_never_rises_in_a_step_even_if_gamma_has_more_observations_than_mtm(
    seed, t, both
):
    """(22)-(23) need only a constant positive definite Γ."""
    rows, a, o_c, a_hat = scene(seed)
    root = compute_inverse_root(build_equations(rows, o_c, both)[0], EPSILON)
    A, b = build_equations(rows[1:], o_c, both)
    inverse = np.linalg.inv(root)

    def U(a_hat):
        return np.sum((inverse @ (a_hat - a)) ** 2)

    assert U(integrate_gradient_flow(A, b, a_hat, np.sqrt(20.0) * root, t)) <= U(a_hat) * (
        1 + 1e-6
    ) + 1e-9 * U(0 * a)


@pytest.mark.parametrize("t", [1e6, 1e9])
def test_u_never_rises_under_the_printed_gamma_in_weeks_or_years_of_estimator_time(t):
    assert (
        max(steepest_rise(seed, t, False, both) for seed in range(10) for both in (False, True))
        < 1e-9
    )


def test_more_time_than_the_fast_gamma_needs_is_refused():
    """Beyond it, rounding lets unobserved modes grow."""
    with pytest.raises(BadInput, match="estimator_time"):
        ProjectionEstimator(rate=20.0, estimator_time=1e4)
    ProjectionEstimator(rate=20.0, estimator_time=1e3)


@given(seeds, st.booleans())
def test_the_equations_are_the_sums_over_the_papers_regressors_of_19(seed, both):
    rows, _, o_c, _ = scene(seed)
    A, b = np.zeros((9, 9)), np.zeros(9)
    for row in rows:
        p1, m = row[:3].copy(), shift_to_rcm(row[3:].copy(), o_c)
        p2 = compute_second_marker(SHAFT, p1)
        for W, pixels in ((build_regressor(m[:2], p1), m[:2]), (build_regressor(m[2:], p2), m[2:]))[
            : 1 + both
        ]:
            A, b = A + W.T @ W, b + W.T @ pixels
    A_found, b_found = build_equations(rows, o_c, both)
    unit = 1 / np.sqrt(np.diag(A))
    assert np.allclose(unit[:, None] * A_found * unit, unit[:, None] * A * unit, atol=1e-12)
    assert np.allclose(unit * b_found, unit * b, atol=1e-12 * np.abs(unit * b).max())


@given(seeds, st.booleans())
def test_the_root_is_that_of_the_regularised_inverse(seed, both):
    rows, _, o_c, _ = scene(seed)
    A, _ = build_equations(rows, o_c, both)
    root, unit = compute_inverse_root(A, EPSILON), np.sqrt(GAMMA_0)
    product = root @ root.T @ (A + EPSILON * np.diag(1 / GAMMA_0))
    assert np.allclose(product / unit[:, None] * unit, np.eye(9), atol=1e-5)


@given(seeds, st.booleans())
def test_the_removed_observation_has_the_least_leverage(seed, both):
    """The leverage is tr(W (MᵀM + εΓ₀⁻¹)⁻¹ Wᵀ)."""
    rows, _, o_c, _ = scene(seed)
    A, _ = build_equations(rows, o_c, both)
    root = compute_inverse_root(A, EPSILON)
    leverages = [np.trace(root.T @ build_equations(row[None], o_c, both)[0] @ root) for row in rows]
    removed = find_least_informative_observation(
        collect_fitted_points(rows, len(rows), o_c, both, SHAFT), len(rows), root
    )
    assert leverages[removed] <= min(leverages) * (1 + 1e-6)


@given(seeds, times)
def test_the_cost_of_20_never_rises_either(seed, t):
    """Q must not rise under (21), with or without noise."""
    random = make_random(seed)
    rows, _, o_c, a_hat = scene(seed)
    rows[:, 3:] += 0.5 * random.standard_normal((len(rows), 4))
    A, b = build_equations(rows, o_c)

    def cost(a):
        return 0.5 * a @ A @ a - b @ a

    for fast in (True, False):
        a_next = integrate_gradient_flow(A, b, a_hat, root_of(A, fast), t)
        assert cost(a_next) <= cost(a_hat) + 1e-9 * abs(b @ np.linalg.lstsq(A, b, rcond=None)[0])


@given(seeds, st.floats(1e-4, 100.0), modes)
def test_integration_is_exact(seed, t, fast):
    """The reference is the matrix exponential of the linear ODE, in coordinates of one size."""
    rows, a, o_c, a_hat = scene(seed)
    A, b = build_equations(rows, o_c)
    C = root_of(A, fast)
    unit = np.sqrt(GAMMA_0)
    system = np.zeros((10, 10))
    system[:9, :9] = -(C @ C.T @ A) / unit[:, None] * unit
    system[:9, 9] = (C @ C.T @ b) / unit
    assume(np.linalg.norm(system[:9, :9]) * t < 1e4)
    expected = unit * (expm(system * t) @ np.append(a_hat / unit, 1.0))[:9]
    integrated = integrate_gradient_flow(A, b, a_hat, C, t)
    tolerance = 1e-6 * np.abs(a / unit).max()
    assert np.allclose(integrated / unit, expected / unit, rtol=0, atol=tolerance)


@given(seeds, st.floats(1e-3, 3.9))
def test_the_series_and_the_modes_give_one_integral(seed, size):
    random = make_random(seed)
    root = random.standard_normal((9, 9)) * np.geomspace(1.0, 1e-4, 9)
    H, deviation = root @ root.T, random.standard_normal(9)
    t = size / np.linalg.norm(H)
    same = 1e-12 * t * np.linalg.norm(deviation)
    assert np.allclose(
        integrate_by_series(H, deviation, t),
        integrate_by_eigenvectors(H, deviation, t),
        rtol=0,
        atol=same,
    )


@given(seeds, st.floats(1e-3, 10.0), st.floats(1e-3, 10.0), modes)
def test_two_successive_times_equal_their_sum(seed, first, second, fast):
    rows, a, o_c, a_hat = scene(seed)
    A, b = build_equations(rows, o_c)
    C = root_of(A, fast)
    once = integrate_gradient_flow(A, b, a_hat, C, first + second)
    twice = integrate_gradient_flow(A, b, integrate_gradient_flow(A, b, a_hat, C, first), C, second)
    assert np.allclose(
        once / np.sqrt(GAMMA_0),
        twice / np.sqrt(GAMMA_0),
        atol=1e-6 * np.abs(a / np.sqrt(GAMMA_0)).max(),
    )


@given(seeds, st.floats(0.5, 50.0), st.floats(0.001, 0.2))
def test_under_the_fast_gamma_every_well_observed_mode_decays_at_the_rate_and_weak_ones_more_slowly(
    seed, rate, t
):
    """A mode with the strength λ in MᵀM relative to Γ₀⁻¹ has the rate η λ/(λ + ε)."""
    rows, a, o_c, _ = scene(seed)
    A, b = build_equations(rows, o_c)
    unit = np.sqrt(GAMMA_0)
    strength, Q = np.linalg.eigh(unit[:, None] * A * unit)
    start = a + unit * (Q @ np.ones(9))
    left = Q.T @ ((integrate_gradient_flow(A, b, start, root_of(A, True, rate), t) - a) / unit)
    assert strength[-1] > 1e3 * EPSILON
    assert np.allclose(left, np.exp(-rate * t * strength / (strength + EPSILON)), rtol=0, atol=1e-4)


def test_the_minimal_depth_is_in_front_of_the_camera_and_below_that_of_an_empty_estimate():
    """ẑ = 1 at â = 0, so that an empty estimate has all observations in front of the camera."""
    assert 0 < MIN_DEPTH < compute_depth(np.zeros(9), np.array([30.0, -40.0, 90.0])) == 1.0


def test_the_printed_gamma_is_slow_and_the_fast_one_is_not():
    printed_energies, fast_energies = [], []
    for seed in range(10):
        rows, a, o_c, _ = scene(seed)
        A, b = build_equations(rows, o_c)
        start = energy(0 * a, a)
        printed_energies.append(
            energy(integrate_gradient_flow(A, b, 0 * a, root_of(A, False), 1.0), a) / start
        )
        fast_energies.append(
            energy(integrate_gradient_flow(A, b, 0 * a, root_of(A, True), 1.0), a) / start
        )
    assert np.median(fast_energies) < 1e-6
    assert np.median(printed_energies) > 1e-3


@given(seeds, st.floats(0.0, 50.0))
def test_no_step_puts_an_observation_below_the_minimal_depth(seed, size):
    random = make_random(seed)
    rows, _, _, a_hat = scene(seed)
    a_next = a_hat + size * random.standard_normal(9) * np.array([1.0] * 6 + [1e-2] * 3)
    limited = limit_step_by_depth(a_hat, a_next, rows, len(rows), SHAFT)

    def minimal_depth(a):
        return min(
            min(
                compute_depth(a, row[:3]),
                compute_depth(a, compute_second_marker(SHAFT, row[:3].copy())),
            )
            for row in rows
        )

    assume(minimal_depth(a_hat) >= MIN_DEPTH)
    assert minimal_depth(limited) >= MIN_DEPTH - 1e-9
    if minimal_depth(a_next) >= MIN_DEPTH:
        assert np.allclose(limited, a_next, rtol=1e-12)
    step_taken, full_step = limited - a_hat, a_next - a_hat
    assert np.linalg.norm(
        np.outer(step_taken, full_step) - np.outer(full_step, step_taken)
    ) <= 1e-9 * (1 + full_step @ full_step)


@given(seeds, times)
def test_an_estimate_that_starts_in_front_of_all_stays_there_whatever_the_camera_reports(seed, t):
    """Even with outliers, ẑ of the stored observations never falls below its minimum."""
    random = make_random(seed)
    rows, _, o_c, _ = scene(seed)
    rows[:, 3:] += random.choice([0, 1, 300], (len(rows), 1)) * random.standard_normal(
        (len(rows), 4)
    )
    memory, count, a_hat = np.zeros((9, 7)), 0, np.zeros(9)
    for row in rows:
        ahead = min(
            compute_depth(a_hat, row[:3]),
            compute_depth(a_hat, compute_second_marker(SHAFT, row[:3].copy())),
        )
        if ahead < MIN_DEPTH:
            continue  # the estimate was behind the camera there before this step
        memory, count, a_hat = step(memory, count, a_hat, row, o_c, t)
        for limited in memory[:count]:
            assert compute_depth(a_hat, limited[:3].copy()) >= MIN_DEPTH - 1e-9
            assert (
                compute_depth(a_hat, compute_second_marker(SHAFT, limited[:3].copy()))
                >= MIN_DEPTH - 1e-9
            )


@pytest.mark.parametrize("seed", range(10))
def test_with_exact_images_the_estimate_converges_to_the_true_jacobian(seed):
    random = make_random(seed)
    positions = draw_tool_positions(random, 60)
    C = draw_calibration_matrix(random, positions)
    o_c = extract_parameters(C)[1]
    estimator, tool = ProjectionEstimator(), TOOLS["rigid"]
    memory = estimator.init()
    for p in positions:
        sample = Sample(p, project_markers(C, p), o_c, 1.0)
        memory = estimator.update(memory, tool, sample)
    J_hat = estimator.jacobian(memory, tool, sample)

    def y(p):
        return compute_feature_error(
            compute_features(shift_to_rcm(project_markers(C, p), o_c)),
            compute_features(shift_to_rcm(sample.points, o_c)),
        )

    J = differentiate(y, sample.p1, 1e-2)
    assert np.linalg.norm((J_hat - J) / FEATURE_SCALE[:, None]) < 1e-3 * np.linalg.norm(
        J / FEATURE_SCALE[:, None]
    )
    assert np.allclose(
        estimator.predict(memory, tool, sample.p1), shift_to_rcm(sample.points, o_c), atol=1e-2
    )


@given(seeds)
def test_an_empty_estimate_gives_a_jacobian_without_rank(seed):
    """With â = 0 the predicted markers do not move."""
    rows, _, o_c, _ = scene(seed, count=2)
    J_hat = compute_estimated_jacobian(
        np.zeros(9), rows[0, :3].copy(), shift_to_rcm(rows[0, 3:].copy(), o_c), SHAFT
    )
    assert not J_hat.any()


@given(seeds)
def test_an_update_leaves_the_previous_memory_unchanged(seed):
    rows, _, o_c, a_hat = scene(seed, count=12)
    memory, count = np.zeros((9, 7)), 0
    for row in rows:
        before = memory.copy(), a_hat.copy(), row.copy(), o_c.copy()
        after, count, a_next = step(memory, count, a_hat, row, o_c, 0.02)
        for now, then in zip((memory, a_hat, row, o_c), before, strict=True):
            assert np.array_equal(now, then)
        memory, a_hat = after, a_next


def test_a_long_rest_keeps_the_informative_observations():
    random = make_random(2)
    positions = draw_tool_positions(random, 12)
    C = draw_calibration_matrix(random, positions)
    o_c = extract_parameters(C)[1]
    memory, count, a_hat = np.zeros((13, 7)), 0, np.zeros(9)
    still = make_observation_rows(C, np.repeat(positions[-1:], 300, axis=0))
    still[:, 3:] += 0.3 * random.standard_normal((300, 4))
    for row in np.concatenate([make_observation_rows(C, positions), still]):
        memory, count, a_hat = step(memory, count, a_hat, row, o_c, 0.02)
    A, _ = build_equations(memory[:count], o_c)
    explored, _ = build_equations(make_observation_rows(C, positions), o_c)
    unit = np.sqrt(GAMMA_0)
    minimal_depth = np.linalg.eigvalsh(unit[:, None] * A * unit)[0]
    assert minimal_depth > 0.3 * np.linalg.eigvalsh(unit[:, None] * explored * unit)[0]
    assert len(np.unique(memory[:count, :3].round(6), axis=0)) >= 10


def test_fitting_marker_1_alone_ignores_marker_2():
    rows, _, o_c, a_hat = scene(1)
    hidden = rows.copy()
    hidden[:, 5:] = 1e3
    for expected, actual in zip(
        build_equations(rows, o_c, both=False),
        build_equations(hidden, o_c, both=False),
        strict=True,
    ):
        assert np.array_equal(expected, actual)
    memory = np.zeros((13, 7))
    assert np.array_equal(
        step(memory, 0, a_hat, rows[0], o_c, 1.0, both=False)[2],
        step(memory, 0, a_hat, hidden[0], o_c, 1.0, both=False)[2],
    )


def test_the_estimators_own_time_replaces_the_real_time_between_frames():
    rows, _, o_c, _ = scene(4)
    results = []
    for estimator, dt in (
        (ProjectionEstimator(), 5.0),
        (ProjectionEstimator(estimator_time=5.0), 0.016),
    ):
        memory = estimator.init()
        for row in rows:
            memory = estimator.update(
                memory, TOOLS["rigid"], Sample(row[:3], row[3:].reshape(2, 2), o_c, dt)
            )
        results.append(memory.a_hat)
    assert np.array_equal(*results)


@pytest.mark.parametrize(
    "invalid",
    [
        {"gamma": "slow"},
        {"rate": 0.0},
        {"rate": np.nan},
        {"epsilon": 0.0},
        {"observations": 5},
        {"estimator_time": -1.0},
        {"estimator_time": np.inf},
    ],
)
def test_settings_that_cannot_work_are_refused(invalid):
    with pytest.raises(BadInput, match=next(iter(invalid))):
        ProjectionEstimator(**invalid)
