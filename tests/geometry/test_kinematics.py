"""Kinematics: eq. (2) as printed, its inverse, joint rates, and checks of joint limits."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import kinds, make_random, make_rcm, seeds
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import (
    MIN_LEVER,
    PITCH_YAW,
    SPHERICAL,
    JointLimits,
    PitchYawRcm,
    SphericalRcm,
    compute_axis,
    compute_axis_jacobian,
    compute_joint_rates,
    compute_joints,
    compute_position,
    compute_position_jacobian,
)
from rcmservo.sim.arm import Drive, SimulatedArm

angles = st.floats(-np.pi, np.pi)
rhos = st.floats(1.0, 300.0)
zeros = st.floats(-10.0, 10.0)
rcms = pytest.mark.parametrize(
    "rcm", [SphericalRcm(), PitchYawRcm(), PitchYawRcm(insertion_zero=-7.0)]
)


@given(angles, angles, rhos)
def test_spherical_coordinates_are_equation_2(theta, phi, rho):
    printed = rho * np.array(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )
    assert np.allclose(compute_position(make_rcm(SPHERICAL), np.array([theta, phi, rho])), printed)


def test_pitch_and_yaw_start_at_minus_z_and_turn_to_x_and_minus_y():
    assert np.allclose(compute_axis(make_rcm(PITCH_YAW), np.zeros(3)), [0, 0, -1])
    assert np.allclose(compute_axis(make_rcm(PITCH_YAW), np.array([np.pi / 2, 0, 0])), [1, 0, 0])
    assert np.allclose(compute_axis(make_rcm(PITCH_YAW), np.array([0, np.pi / 2, 0])), [0, -1, 0])


@given(kinds, angles, angles, rhos, zeros)
def test_the_distance_from_the_rcm_is_insertion_plus_zero_at_any_angle(
    kind, first, second, rho, zero
):
    p = compute_position(make_rcm(kind, zero), np.array([first, second, rho - zero]))
    assert np.linalg.norm(p) == pytest.approx(rho)


@given(kinds, st.floats(0.01, 1.5), angles, rhos, zeros)
def test_inverse_kinematics_inverts_the_position(kind, inner, outer, rho, zero):
    q = np.array(
        [inner, outer, rho - zero] if kind == SPHERICAL else [outer, inner - 0.75, rho - zero]
    )
    assert np.allclose(
        compute_joints(make_rcm(kind, zero), compute_position(make_rcm(kind, zero), q)),
        q,
        atol=1e-9,
    )


@given(kinds, angles, angles)
def test_axis_and_its_derivatives_are_orthogonal(kind, first, second):
    """The joint rates are a projection, not an inversion, because the columns are orthogonal."""
    q = np.array([first, second, 100.0])
    along = np.column_stack(
        [*compute_axis_jacobian(make_rcm(kind), q), compute_axis(make_rcm(kind), q)]
    )
    products = along.T @ along
    assert np.allclose(products - np.diag(np.diag(products)), 0, atol=1e-12)


@given(kinds, seeds, angles, angles, rhos, zeros)
def test_joint_rates_give_the_requested_velocity_outside_singularities(
    kind, seed, first, second, rho, zero
):
    q = np.array([first, second, rho - zero])
    lever = abs(np.sin(first)) if kind == SPHERICAL else abs(np.cos(second))
    assume(lever > 2 * MIN_LEVER)
    v = make_random(seed).uniform(-50, 50, 3)
    assert np.allclose(
        compute_position_jacobian(make_rcm(kind, zero), q)
        @ compute_joint_rates(make_rcm(kind, zero), q, v),
        v,
        atol=1e-8,
    )


@given(kinds, seeds, st.one_of(st.just(0.0), st.floats(-1e-2, 1e-2)), angles, rhos)
def test_joint_rates_are_bounded_at_the_singularity_and_never_exceed_the_request(
    kind, seed, near, other, rho
):
    q = np.array([near, other, rho] if kind == SPHERICAL else [other, np.pi / 2 + near, rho])
    v = make_random(seed).uniform(-50, 50, 3)
    rcm = make_rcm(kind)
    rates = compute_joint_rates(rcm, q, v)
    assert np.all(np.abs(rates[:2]) <= np.linalg.norm(v) / (MIN_LEVER * rho) * 1.001)
    assert np.linalg.norm(compute_position_jacobian(rcm, q) @ rates) <= np.linalg.norm(v) * (
        1 + 1e-9
    )


def test_joint_rates_at_theta_zero_and_at_the_rcm_raise_no_error():
    v = np.array([1.0, 2.0, 3.0])
    assert np.isfinite(
        compute_joint_rates(make_rcm(SPHERICAL), np.array([0.0, 0.0, 100.0]), v)
    ).all()
    assert compute_joint_rates(make_rcm(SPHERICAL), np.zeros(3), v)[2] == 3.0


@rcms
@pytest.mark.parametrize("seed", range(3))
def test_the_simulated_arm_follows_equation_2(rcm, seed):
    q = make_random(seed).uniform(rcm.limits.lower, rcm.limits.upper)
    arm = SimulatedArm(rcm, Drive())
    arm.place(q)
    assert np.allclose(arm.p_true, rcm.position(q), atol=1e-6)


@rcms
def test_methods_take_any_memory_order_and_agree_with_the_functions(rcm):
    q = np.array([[0.4, 9], [-0.3, 9], [90.0, 9]])[:, 0]  # not contiguous
    assert np.array_equal(rcm.position(q), compute_position(rcm.to_struct(), q.copy()))
    assert np.array_equal(rcm.jacobian(q), compute_position_jacobian(rcm.to_struct(), q.copy()))
    assert np.allclose(rcm.position(rcm.joints(rcm.position(q))), rcm.position(q))


@pytest.mark.parametrize(
    "bad", [(0.0, 0.0, np.nan), (0.0, 0.0, np.inf), (2.0, 0.0, 50.0), (0.0, 1.0, 50.0)]
)
def test_limits_that_are_not_finite_or_not_ordered_are_refused_by_name(bad):
    with pytest.raises(BadInput, match=r"lower|upper"):
        JointLimits(lower=bad, upper=(1.0, 1.0, 100.0))


@pytest.mark.parametrize(
    ("lower", "upper", "unit"),
    [
        ((8.0, -3.0, 40.0), (85.0, 3.0, 220.0), "degrees"),
        ((-1.0, -180.0, 40.0), (1.0, 1.0, 220.0), "degrees"),
        ((-1.0, -1.0, 40_000.0), (1.0, 1.0, 220_000.0), "µm"),
        ((-1.0, -1.0, 0.04), (1.0, 1.0, 0.22), "like m"),
    ],
)
def test_limits_of_implausible_size_name_their_likely_unit(lower, upper, unit):
    with pytest.raises(BadInput, match=rf"(lower|upper) must be .*{unit}"):
        JointLimits(lower, upper)


@pytest.mark.parametrize("zero", [np.nan, np.inf, -40.0, -100.0])
def test_an_insertion_zero_that_puts_the_marker_at_or_behind_the_rcm_is_refused(zero):
    with pytest.raises(BadInput):
        PitchYawRcm(insertion_zero=zero)
