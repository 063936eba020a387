"""Analytic derivatives equal finite differences, also near their singularities."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import (
    SHAFT,
    SPACING_MM,
    differentiate,
    draw_calibration_matrix,
    draw_tool_positions,
    kinds,
    make_random,
    make_rcm,
    project_markers,
    seeds,
)
from rcmservo.control.saturated_controller import compute_potential, compute_potential_gradient
from rcmservo.estimation.projection_rule import (
    compute_estimated_jacobian,
    compute_markers_jacobian,
    predict_markers,
)
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    compute_feature_error,
    compute_features,
    compute_features_jacobian,
    compute_line_features,
    shift_to_rcm,
    write_line_features_jacobian,
)
from rcmservo.geometry.kinematics import (
    PitchYawRcm,
    SphericalRcm,
    compute_axis,
    compute_axis_jacobian,
    compute_position,
    compute_position_jacobian,
)
from rcmservo.geometry.projection import (
    compute_depth,
    compute_projection_jacobian,
    extract_parameters,
    project,
)
from rcmservo.geometry.tool import (
    RIGID,
    SCALED,
    RigidTool,
    ScaledTool,
    ToolStruct,
    compute_second_marker,
    compute_second_marker_jacobian,
)
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.ground_truth import compute_true_jacobian_at_joints as true_feature_jacobian
from rcmservo.sim.tool_body import ToolBody

angles = st.one_of(
    st.floats(-np.pi, np.pi), st.sampled_from([0.0, 1e-9, 1e-4, np.pi / 2, np.pi / 2 - 1e-6])
)
points = st.tuples(*[st.floats(-150, 150)] * 3).map(np.array)
markers = st.tuples(*[st.floats(-400, 400)] * 4).map(np.array)
tools = st.one_of(
    st.builds(ToolStruct, st.just(RIGID), st.floats(1, 80)),
    st.builds(ToolStruct, st.just(SCALED), st.floats(1.01, 3)),
)


@given(kinds, angles, angles, st.floats(0.01, 300), st.floats(-5, 5))
def test_derivatives_of_position_and_axis_are_analytic(kind, first, second, rho, zero):
    q, rcm = np.array([first, second, rho - zero]), make_rcm(kind, zero)
    numeric = differentiate(lambda q: compute_position(rcm, q), q, [1e-3, 1e-3, 1e-3 * rho])
    assert np.allclose(compute_position_jacobian(rcm, q), numeric, rtol=0, atol=1e-9 * max(rho, 1))
    assert np.allclose(
        np.transpose(compute_axis_jacobian(rcm, q)),
        differentiate(lambda q: compute_axis(rcm, q), q, 1e-3)[:, :2],
        atol=1e-10,
    )


@given(tools, points)
def test_derivative_of_marker_2_is_analytic(tool, p1):
    rho = np.linalg.norm(p1)
    assume(rho > 0.1)  # a rigid shaft has no direction at the RCM
    numeric = differentiate(lambda p: compute_second_marker(tool, p), p1, 1e-3 * rho)
    assert np.allclose(
        compute_second_marker_jacobian(tool, p1),
        numeric,
        rtol=0,
        atol=1e-9 * (1 + tool.value / rho),
    )


@given(seeds, points)
def test_derivative_of_the_projection_is_analytic(seed, p):
    random = make_random(seed)
    a = np.concatenate([random.uniform(-5, 5, 6), random.uniform(-0.01, 0.01, 3)])
    z = compute_depth(a, p)
    assume(abs(z) > 1e-3)  # z = 0 is the plane of the camera
    step = 1e-3 * abs(z) / 0.01
    numeric = differentiate(lambda p: project(a, p), p, step)
    assert np.allclose(
        compute_projection_jacobian(a, p),
        numeric,
        rtol=1e-7,
        atol=1e-9 * (1 + np.abs(numeric).max()),
    )


@given(markers, st.one_of(st.just(1.0), st.floats(1e-6, 1.0)))
def test_derivative_of_the_features_holds_for_close_markers_too(m, closeness):
    m[2:] = m[:2] + closeness * (m[2:] - m[:2])
    nearest = min(np.linalg.norm(m[:2]), np.linalg.norm(m[2:] - m[:2]))
    assume(nearest > 1e-3)

    def change(x):
        return compute_feature_error(compute_features(x), compute_features(m))

    numeric = differentiate(change, m, 1e-3 * nearest)
    rounding = 1e-13 * np.abs(m).max() / (1e-3 * nearest)  # rounding of m, over the step
    assert np.allclose(
        compute_features_jacobian(m), numeric, rtol=1e-8, atol=1e-9 + rounding * max(1, 1 / nearest)
    )


@given(seeds, tools)
def test_derivative_of_the_features_holds_for_given_projection_parameters(seed, tool):
    random = make_random(seed)
    p1 = draw_tool_positions(random, 1)[0]
    a, _ = extract_parameters(draw_calibration_matrix(random, p1[None]))
    assume(compute_depth(a, compute_second_marker(tool, p1)) > 0.05)
    m = predict_markers(a, p1, tool)
    assume(np.linalg.norm(m[2:] - m[:2]) > 0.5)
    assert np.allclose(
        compute_markers_jacobian(a, p1, tool),
        differentiate(lambda p: predict_markers(a, p, tool), p1, 1e-2),
        rtol=1e-6,
        atol=1e-7,
    )
    J = compute_estimated_jacobian(a, p1, m, tool)
    numeric = differentiate(
        lambda p: compute_feature_error(
            compute_features(predict_markers(a, p, tool)), compute_features(m)
        ),
        p1,
        1e-2,
    )
    assert (
        np.abs((J - numeric) / FEATURE_SCALE[:, None]).max()
        < 1e-6 * np.abs(J / FEATURE_SCALE[:, None]).max()
    )


@given(seeds)
def test_derivative_of_the_features_holds_for_a_full_calibration_matrix(seed):
    """Compare the raw pixels with the Jacobian of Lemma 1's parameters, without a loss of terms."""
    random = make_random(seed)
    p1 = draw_tool_positions(random, 1)[0]
    C = draw_calibration_matrix(random, p1[None])
    a, o_c = extract_parameters(C)
    m = shift_to_rcm(project_markers(C, p1), o_c)
    J = compute_estimated_jacobian(a, p1, m, SHAFT)
    numeric = differentiate(
        lambda p: compute_feature_error(
            compute_features(shift_to_rcm(project_markers(C, p), o_c)), compute_features(m)
        ),
        p1,
        1e-2,
    )
    assert (
        np.abs((J - numeric) / FEATURE_SCALE[:, None]).max()
        < 1e-6 * np.abs(J / FEATURE_SCALE[:, None]).max()
    )


BOUNDS = np.array([np.radians(10.0), 10.0, 40.0])
errors = st.one_of(
    st.floats(-5, 5), st.sampled_from([-1.0, 1.0, 0.0, 1.0 - 1e-9, 1.0 + 1e-9, -1.0 + 1e-9])
)

not_at_the_kink = st.floats(-5, 5).filter(lambda share: abs(abs(share) - 1.0) > 1e-2)


@given(st.tuples(errors, errors, errors))
def test_gradient_of_the_continuous_potential_holds_at_its_bounds_too(shares):
    delta, step = np.array(shares) * BOUNDS, 1e-6 * BOUNDS.min()
    numeric = differentiate(lambda x: compute_potential(x, BOUNDS, False), delta, step)
    assert np.allclose(
        compute_potential_gradient(delta, BOUNDS, False), numeric, rtol=0, atol=2e-6 * BOUNDS.max()
    )


@given(st.tuples(not_at_the_kink, not_at_the_kink, not_at_the_kink))
def test_gradient_of_the_printed_potential_holds_outside_its_kink(shares):
    delta = np.array(shares) * BOUNDS
    numeric = differentiate(
        lambda x: compute_potential(x, BOUNDS, True), delta, 1e-3 * BOUNDS.min()
    )
    assert np.allclose(compute_potential_gradient(delta, BOUNDS, True), numeric, rtol=0, atol=1e-8)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_printed_potential_is_continuous_but_its_gradient_drops_by_half_at_the_bound(sign):
    below, above = sign * BOUNDS * (1 - 1e-12), sign * BOUNDS * (1 + 1e-12)
    assert compute_potential(below, BOUNDS, True) == pytest.approx(
        compute_potential(above, BOUNDS, True), rel=1e-9
    )
    assert np.allclose(compute_potential_gradient(below, BOUNDS, True), sign * BOUNDS)
    assert np.allclose(compute_potential_gradient(above, BOUNDS, True), sign * BOUNDS / 2)
    assert np.allclose(compute_potential_gradient(above, BOUNDS, False), sign * BOUNDS)


@given(
    seeds,
    st.sampled_from([SphericalRcm(), PitchYawRcm(insertion_zero=-3.0)]),
    st.sampled_from(
        [RigidTool(SPACING_MM), RigidTool(SPACING_MM, offset=12.0), ScaledTool(1.3, offset=-8.0)]
    ),
    st.floats(-0.25, 0.05),
    st.floats(-0.02, 0.05),
)
def test_derivative_of_the_features_holds_for_a_lens_with_distortion(seed, mechanism, tool, k1, k2):
    """The Jacobian of the ground truth, along all joints: ∂y/∂q = J ∂p₁/∂q."""
    random = make_random(seed)
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
        return shift_to_rcm(optics.project(body.points(q)[:2]), o_c)

    m = project_with_lens(q)
    assume(np.isfinite(m).all() and np.linalg.norm(m[:2] - m[2:]) > 2 and np.linalg.norm(m[:2]) > 2)
    numeric = differentiate(
        lambda q: compute_feature_error(
            compute_features(project_with_lens(q)), compute_features(m)
        ),
        q,
        [1e-5, 1e-5, 1e-3],
    )
    marker = compute_position_jacobian(mechanism.to_struct(tool.offset), q)
    J = true_feature_jacobian(body, optics, q, o_c) @ marker
    assert (
        np.abs((J - numeric) / FEATURE_SCALE[:, None]).max()
        < 1e-6 * np.abs(J / FEATURE_SCALE[:, None]).max()
    )


@given(markers, st.floats(1.1, 4.0), st.floats(-0.3, 0.3))
def test_derivative_of_the_line_features_is_analytic(m, further, bend):
    u, v = m[:2]
    assume(np.hypot(u, v) > 20.0)
    m[2:] = further * np.array([u - bend * v, v + bend * u])
    J = np.empty((3, 4))
    write_line_features_jacobian(m, J)
    numeric = differentiate(compute_line_features, m, 1e-2)
    assume(np.abs(numeric).max() < 10.0)
    assert np.allclose(J, numeric, rtol=0, atol=1e-7)
