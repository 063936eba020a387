"""Analytic derivatives equal finite differences, also near their singularities."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import (
    SHAFT,
    SPACING,
    derivative,
    kinds,
    markers_seen,
    random_from,
    rcm_of,
    seeds,
    tool_positions,
    true_camera,
)
from rcmservo.control.saturated_controller import potential, potential_gradient
from rcmservo.estimation.projection_rule import feature_jacobian, markers_jacobian, predict
from rcmservo.geometry.features import (
    SCALE,
    about,
    compute_line_features,
    difference,
    features,
    features_jacobian,
    straight_jacobian,
)
from rcmservo.geometry.kinematics import (
    PitchYawRcm,
    SphericalRcm,
    axis,
    compute_axis_jacobian,
    position,
    position_jacobian,
)
from rcmservo.geometry.projection import depth, parameters, project, project_jacobian
from rcmservo.geometry.tool import (
    RIGID,
    SCALED,
    RigidTool,
    ScaledTool,
    Shaft,
    second_marker,
    second_marker_jacobian,
)
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.ground_truth import compute_feature_jacobian as true_feature_jacobian
from rcmservo.sim.tool_body import ToolBody

angles = st.one_of(
    st.floats(-np.pi, np.pi), st.sampled_from([0.0, 1e-9, 1e-4, np.pi / 2, np.pi / 2 - 1e-6])
)
points = st.tuples(*[st.floats(-150, 150)] * 3).map(np.array)
markers = st.tuples(*[st.floats(-400, 400)] * 4).map(np.array)
tools = st.one_of(
    st.builds(Shaft, st.just(RIGID), st.floats(1, 80)),
    st.builds(Shaft, st.just(SCALED), st.floats(1.01, 3)),
)


@given(kinds, angles, angles, st.floats(0.01, 300), st.floats(-5, 5))
def test_derivatives_of_position_and_axis_are_analytic(kind, first, second, rho, zero):
    q, rcm = np.array([first, second, rho - zero]), rcm_of(kind, zero)
    numeric = derivative(lambda q: position(rcm, q), q, [1e-3, 1e-3, 1e-3 * rho])
    assert np.allclose(position_jacobian(rcm, q), numeric, rtol=0, atol=1e-9 * max(rho, 1))
    assert np.allclose(
        np.transpose(compute_axis_jacobian(rcm, q)),
        derivative(lambda q: axis(rcm, q), q, 1e-3)[:, :2],
        atol=1e-10,
    )


@given(tools, points)
def test_derivative_of_marker_2_is_analytic(tool, p1):
    rho = np.linalg.norm(p1)
    assume(rho > 0.1)  # a rigid shaft has no direction at the RCM
    numeric = derivative(lambda p: second_marker(tool, p), p1, 1e-3 * rho)
    assert np.allclose(
        second_marker_jacobian(tool, p1), numeric, rtol=0, atol=1e-9 * (1 + tool.value / rho)
    )


@given(seeds, points)
def test_derivative_of_the_projection_is_analytic(seed, p):
    random = random_from(seed)
    a = np.concatenate([random.uniform(-5, 5, 6), random.uniform(-0.01, 0.01, 3)])
    z = depth(a, p)
    assume(abs(z) > 1e-3)  # z = 0 is the plane of the camera
    step = 1e-3 * abs(z) / 0.01
    numeric = derivative(lambda p: project(a, p), p, step)
    assert np.allclose(
        project_jacobian(a, p), numeric, rtol=1e-7, atol=1e-9 * (1 + np.abs(numeric).max())
    )


@given(markers, st.one_of(st.just(1.0), st.floats(1e-6, 1.0)))
def test_derivative_of_the_features_holds_for_close_markers_too(m, closeness):
    m[2:] = m[:2] + closeness * (m[2:] - m[:2])
    nearest = min(np.linalg.norm(m[:2]), np.linalg.norm(m[2:] - m[:2]))
    assume(nearest > 1e-3)

    def change(x):
        return difference(features(x), features(m))

    numeric = derivative(change, m, 1e-3 * nearest)
    rounding = 1e-13 * np.abs(m).max() / (1e-3 * nearest)  # rounding of m, over the step
    assert np.allclose(
        features_jacobian(m), numeric, rtol=1e-8, atol=1e-9 + rounding * max(1, 1 / nearest)
    )


@given(seeds, tools)
def test_derivative_of_the_features_holds_for_given_projection_parameters(seed, tool):
    random = random_from(seed)
    p1 = tool_positions(random, 1)[0]
    a, _ = parameters(true_camera(random, p1[None]))
    assume(depth(a, second_marker(tool, p1)) > 0.05)
    m = predict(a, p1, tool)
    assume(np.linalg.norm(m[2:] - m[:2]) > 0.5)
    assert np.allclose(
        markers_jacobian(a, p1, tool),
        derivative(lambda p: predict(a, p, tool), p1, 1e-2),
        rtol=1e-6,
        atol=1e-7,
    )
    J = feature_jacobian(a, p1, m, tool)
    numeric = derivative(lambda p: difference(features(predict(a, p, tool)), features(m)), p1, 1e-2)
    assert np.abs((J - numeric) / SCALE[:, None]).max() < 1e-6 * np.abs(J / SCALE[:, None]).max()


@given(seeds)
def test_derivative_of_the_features_holds_for_a_full_calibration_matrix(seed):
    """Compare the raw pixels with the Jacobian of Lemma 1's parameters, without a loss of terms."""
    random = random_from(seed)
    p1 = tool_positions(random, 1)[0]
    C = true_camera(random, p1[None])
    a, o_c = parameters(C)
    m = about(markers_seen(C, p1), o_c)
    J = feature_jacobian(a, p1, m, SHAFT)
    numeric = derivative(
        lambda p: difference(features(about(markers_seen(C, p), o_c)), features(m)), p1, 1e-2
    )
    assert np.abs((J - numeric) / SCALE[:, None]).max() < 1e-6 * np.abs(J / SCALE[:, None]).max()


BOUNDS = np.array([np.radians(10.0), 10.0, 40.0])
errors = st.one_of(
    st.floats(-5, 5), st.sampled_from([-1.0, 1.0, 0.0, 1.0 - 1e-9, 1.0 + 1e-9, -1.0 + 1e-9])
)

not_at_the_kink = st.floats(-5, 5).filter(lambda share: abs(abs(share) - 1.0) > 1e-2)


@given(st.tuples(errors, errors, errors))
def test_gradient_of_the_continuous_potential_holds_at_its_bounds_too(shares):
    delta, step = np.array(shares) * BOUNDS, 1e-6 * BOUNDS.min()
    numeric = derivative(lambda x: potential(x, BOUNDS, False), delta, step)
    assert np.allclose(
        potential_gradient(delta, BOUNDS, False), numeric, rtol=0, atol=2e-6 * BOUNDS.max()
    )


@given(st.tuples(not_at_the_kink, not_at_the_kink, not_at_the_kink))
def test_gradient_of_the_printed_potential_holds_outside_its_kink(shares):
    delta = np.array(shares) * BOUNDS
    numeric = derivative(lambda x: potential(x, BOUNDS, True), delta, 1e-3 * BOUNDS.min())
    assert np.allclose(potential_gradient(delta, BOUNDS, True), numeric, rtol=0, atol=1e-8)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_printed_potential_is_continuous_but_its_gradient_drops_by_half_at_the_bound(sign):
    below, above = sign * BOUNDS * (1 - 1e-12), sign * BOUNDS * (1 + 1e-12)
    assert potential(below, BOUNDS, True) == pytest.approx(potential(above, BOUNDS, True), rel=1e-9)
    assert np.allclose(potential_gradient(below, BOUNDS, True), sign * BOUNDS)
    assert np.allclose(potential_gradient(above, BOUNDS, True), sign * BOUNDS / 2)
    assert np.allclose(potential_gradient(above, BOUNDS, False), sign * BOUNDS)


@given(
    seeds,
    st.sampled_from([SphericalRcm(), PitchYawRcm(insertion_zero=-3.0)]),
    st.sampled_from(
        [RigidTool(SPACING), RigidTool(SPACING, offset=12.0), ScaledTool(1.3, offset=-8.0)]
    ),
    st.floats(-0.25, 0.05),
    st.floats(-0.02, 0.05),
)
def test_derivative_of_the_features_holds_for_a_lens_with_distortion(seed, mechanism, tool, k1, k2):
    """The Jacobian of the ground truth, along all joints: ∂y/∂q = J ∂p₁/∂q."""
    random = random_from(seed)
    body = ToolBody(mechanism, tool)
    lower, upper = np.array(mechanism.limits.lower), np.array(mechanism.limits.upper)
    q = random.uniform(lower + 0.1 * (upper - lower), upper - 0.1 * (upper - lower))
    marker_positions = body.points(q)[:2]
    direction = random.standard_normal(3)
    position_of_camera = marker_positions.mean(axis=0) + 250 * direction / np.linalg.norm(direction)
    centre = np.array([320.0, 240.0])
    rotation = compute_look_at_rotation(
        position_of_camera,
        marker_positions.mean(axis=0) + random.uniform(-30, 30, 3),
        random.uniform(-3, 3),
    )
    optics = CameraModel(640, 480, 700.0, centre, np.array([k1, k2]), rotation, position_of_camera)
    o_c = random.uniform(-200, 800, 2)

    def project_with_lens(q):
        return about(optics.project(body.points(q)[:2]), o_c)

    m = project_with_lens(q)
    assume(np.isfinite(m).all() and np.linalg.norm(m[:2] - m[2:]) > 2 and np.linalg.norm(m[:2]) > 2)
    numeric = derivative(
        lambda q: difference(features(project_with_lens(q)), features(m)), q, [1e-5, 1e-5, 1e-3]
    )
    marker = position_jacobian(mechanism.rcm(tool.offset), q)
    J = true_feature_jacobian(body, optics, q, o_c) @ marker
    assert np.abs((J - numeric) / SCALE[:, None]).max() < 1e-6 * np.abs(J / SCALE[:, None]).max()


@given(markers, st.floats(1.1, 4.0), st.floats(-0.3, 0.3))
def test_derivative_of_the_line_features_is_analytic(m, further, bend):
    u, v = m[:2]
    assume(np.hypot(u, v) > 20.0)
    m[2:] = further * np.array([u - bend * v, v + bend * u])
    J = np.empty((3, 4))
    straight_jacobian(m, J)
    numeric = derivative(compute_line_features, m, 1e-2)
    assume(np.abs(numeric).max() < 10.0)
    assert np.allclose(J, numeric, rtol=0, atol=1e-7)
