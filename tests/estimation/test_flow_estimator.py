"""Proposition 2: R never rises, rule (28) is integrated exactly, and updates are unbiased."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from conftest import (
    TOOLS,
    draw_calibration_matrix,
    make_observation,
    make_random,
    project_markers,
    seeds,
)
from rcmservo.errors import BadInput
from rcmservo.estimation.base import Sample
from rcmservo.estimation.flow_rule import FlowEstimator, integrate_flow_rule
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    compute_feature_error,
    compute_features,
    shift_to_rcm,
)
from rcmservo.geometry.imaged_rcm import ImagedRcm
from rcmservo.geometry.kinematics import PitchYawRcm
from rcmservo.geometry.projection import extract_parameters
from rcmservo.interfaces import Target
from rcmservo.servo.servo import Servo

lengths = st.one_of(st.floats(1e-9, 1e-3), st.floats(1e-3, 10), st.floats(10, 1e3))
gammas = st.floats(1e-4, 10)
intervals = st.floats(1e-3, 10)


def problem(seed):
    random = make_random(seed)
    direction = random.standard_normal(3)
    return (
        random.uniform(-5, 5, (3, 3)),
        random.uniform(-5, 5, (3, 3)),
        direction / np.linalg.norm(direction),
    )


@given(seeds, lengths, intervals, gammas)
def test_proposition_2_no_row_of_the_error_grows_at_any_step_length(seed, length, dt, gamma):
    J, J_hat, direction = problem(seed)
    delta_p = length * direction
    after = integrate_flow_rule(J_hat, delta_p, J @ delta_p, dt, gamma)
    R, R_after = np.sum((J_hat - J) ** 2, axis=1), np.sum((after - J) ** 2, axis=1)
    assert np.all(R_after <= R * (1 + 1e-12))


@given(seeds, lengths, intervals, gammas)
def test_the_error_along_the_motion_decays_as_exp_of_gamma_v_l_and_across_it_not_at_all(
    seed, length, dt, gamma
):
    J, J_hat, direction = problem(seed)
    delta_p = length * direction
    error, after = J_hat - J, integrate_flow_rule(J_hat, delta_p, J @ delta_p, dt, gamma) - J
    assert np.allclose(
        after @ direction, np.exp(-gamma * length**2 / dt) * (error @ direction), atol=1e-9
    )
    across = np.eye(3) - np.outer(direction, direction)
    assert np.allclose(after @ across, error @ across, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("gamma", [1e-3, 0.05])
def test_a_step_is_the_solution_of_rule_28_for_the_mean_velocity(seed, gamma):
    J, J_hat, direction = problem(seed)
    dt, delta_p = 0.5, 8.0 * direction
    p_dot, y_dot = delta_p / dt, J @ delta_p / dt

    def rule(_, flat):
        return (-gamma * np.outer(flat.reshape(3, 3) @ p_dot - y_dot, p_dot)).ravel()

    expected = (
        solve_ivp(rule, (0, dt), J_hat.ravel(), rtol=1e-11, atol=1e-12).y[:, -1].reshape(3, 3)
    )
    assert np.allclose(
        integrate_flow_rule(J_hat, delta_p, J @ delta_p, dt, gamma), expected, atol=1e-8
    )


@given(seeds, lengths, intervals, gammas)
def test_two_halves_of_a_step_are_the_whole(seed, length, dt, gamma):
    J, J_hat, direction = problem(seed)
    delta_p, delta_y = length * direction, J @ (length * direction)
    half = integrate_flow_rule(J_hat, delta_p / 2, delta_y / 2, dt / 2, gamma)
    assert np.allclose(
        integrate_flow_rule(half, delta_p / 2, delta_y / 2, dt / 2, gamma),
        integrate_flow_rule(J_hat, delta_p, delta_y, dt, gamma),
        atol=1e-9,
    )


@pytest.mark.parametrize(
    "delta_p,dt", [(np.zeros(3), 0.02), (np.ones(3), 0.0), (np.ones(3), -1.0), (np.ones(3), np.nan)]
)
def test_no_motion_or_no_time_changes_nothing_and_returns_a_copy(delta_p, dt):
    J = np.arange(9.0).reshape(3, 3)
    after = integrate_flow_rule(J, delta_p, np.ones(3), dt, 0.05)
    assert np.array_equal(after, J)
    assert not np.shares_memory(after, J)


def test_the_first_frame_changes_nothing_and_the_second_one_does():
    estimator, tool = FlowEstimator(), TOOLS["rigid"]
    first = Sample(np.array([0.0, 0, 100]), np.array([[10.0, 20], [30, 50]]), np.zeros(2), 0.0)
    second = Sample(np.array([1.0, 0, 100]), np.array([[12.0, 20], [33, 50]]), np.zeros(2), 0.02)
    memory = estimator.update(estimator.init(), tool, first)
    assert not estimator.jacobian(memory, tool, first).any()
    assert estimator.jacobian(estimator.update(memory, tool, second), tool, second).any()
    assert not memory.J_hat.any()
    assert estimator.predict(memory, tool, first.p1) is None


def straight_motion(gamma):
    """Return Ĵ ṗ₁ and J ṗ₁ along a straight motion of marker 1, as one servo estimates them.

    Marker 1 moves at 20 mm/s; the camera gives 60 frames/s, and the loop runs at 100 Hz.
    """
    random = make_random(11)
    mechanism, tool = PitchYawRcm(), TOOLS["rigid"]
    start, direction = np.array([15.0, -10.0, -100.0]), np.array([0.8, 0.5, 0.33])
    direction /= np.linalg.norm(direction)
    C = draw_calibration_matrix(random, start + np.linspace(-5, 45, 9)[:, None] * direction)
    o_c = extract_parameters(C)[1]
    servo = Servo(
        mechanism, tool, estimator=FlowEstimator(gamma), imaged_rcm=ImagedRcm(max_condition=1e11)
    )
    target, state, repeats = Target(project_markers(C, start), np.zeros(3)), servo.init(), 0
    for tick in range(1, 150):
        frame = int(np.floor(tick * 0.6 + 1e-9))
        exposure = round(frame * 1e9 / 60)
        p = start + 20.0 * exposure * 1e-9 * direction
        q = mechanism.joints(p)
        before = state
        state = servo.step(
            state,
            make_observation(tick * 10_000_000, q, frame, exposure, q, project_markers(C, p)),
            target,
        )
        if frame == before.newest_frame:
            repeats += 1
            assert state.estimation.memory is before.estimation.memory
    assert 0.35 < repeats / 149 < 0.45
    step = 1e-3 * direction
    y = [
        compute_features(shift_to_rcm(project_markers(C, p + side * step), o_c)) for side in (-1, 1)
    ]
    return state.J_hat @ direction, compute_feature_error(y[1], y[0]) / 2e-3


def test_at_60_frames_in_a_100_hertz_loop_the_update_per_frame_is_unbiased():
    """Updates with repeated frames as zero flow would give 0.6 of the flow."""
    estimated, true = straight_motion(gamma=0.1)
    fraction = (
        (estimated / FEATURE_SCALE) @ (true / FEATURE_SCALE) / np.sum((true / FEATURE_SCALE) ** 2)
    )
    assert fraction == pytest.approx(1.0, abs=0.05)


def test_at_the_papers_gain_one_and_a_half_seconds_at_20_mm_per_second_give_half_of_the_flow():
    """1 - exp(-γ v L): with γ = 0.001, v = 20 mm/s and L = 29.5 mm that is 45 %."""
    estimated, true = straight_motion(gamma=0.001)
    fraction = (
        (estimated / FEATURE_SCALE) @ (true / FEATURE_SCALE) / np.sum((true / FEATURE_SCALE) ** 2)
    )
    assert fraction == pytest.approx(1 - np.exp(-0.001 * 20 * 29.5), abs=0.12)


@pytest.mark.parametrize("gamma", [0.0, -0.001, np.nan, np.inf])
def test_a_gain_that_is_no_positive_number_is_refused(gamma):
    with pytest.raises(BadInput, match="gamma"):
        FlowEstimator(gamma)
