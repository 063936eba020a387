"""Lemma 1: nine parameters describe the projection, and enough tool positions determine them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import (
    build_equations,
    draw_calibration_matrix,
    draw_tool_positions,
    make_observation_rows,
    make_random,
    project_points,
    seeds,
)
from rcmservo.geometry.projection import (
    PARAMETER_COUNT,
    build_regressor,
    compute_depth,
    extract_parameters,
    project,
)


@given(seeds)
def test_nine_parameters_reproduce_the_image_of_any_calibration_matrix(seed):
    random = make_random(seed)
    positions = draw_tool_positions(random, 8)
    C = draw_calibration_matrix(random, positions)
    a, o_c = extract_parameters(C)
    assert a.shape == (PARAMETER_COUNT,)
    for p, image in zip(positions, project_points(C, positions), strict=True):
        assert np.allclose(project(a, p) + o_c, image, rtol=0, atol=1e-8)


@given(seeds, st.floats(-1e6, 1e6).filter(lambda scale: abs(scale) > 1e-6))
def test_scale_and_sign_of_the_calibration_matrix_do_not_matter(seed, scale):
    random = make_random(seed)
    C = draw_calibration_matrix(random, draw_tool_positions(random, 3))
    for actual, expected in zip(extract_parameters(scale * C), extract_parameters(C), strict=True):
        assert np.allclose(actual, expected, rtol=1e-12)


@given(seeds)
def test_a_shift_of_the_pixel_origin_moves_the_imaged_rcm_only(seed):
    random = make_random(seed)
    C = draw_calibration_matrix(random, draw_tool_positions(random, 3))
    shift = random.uniform(-500, 500, 2)
    shifted = C + np.outer(np.append(shift, 0.0), C[2])
    (a, o_c), (a_shifted, o_c_shifted) = extract_parameters(C), extract_parameters(shifted)
    assert np.allclose(a_shifted, a, rtol=1e-9, atol=1e-11)
    assert np.allclose(o_c_shifted, o_c + shift)


@given(seeds)
def test_the_rcm_projects_to_the_origin_at_depth_one(seed):
    random = make_random(seed)
    C = draw_calibration_matrix(random, draw_tool_positions(random, 3))
    a, o_c = extract_parameters(C)
    assert np.array_equal(project(a, np.zeros(3)), np.zeros(2))
    assert compute_depth(a, np.zeros(3)) == 1.0
    assert np.allclose(o_c, project_points(C, np.zeros((1, 3)))[0])


@given(seeds)
def test_depth_is_relative_to_the_depth_of_the_rcm(seed):
    random = make_random(seed)
    p = draw_tool_positions(random, 1)[0]
    C = draw_calibration_matrix(random, p[None])
    assert compute_depth(extract_parameters(C)[0], p) == pytest.approx(
        (C[2, :3] @ p + C[2, 3]) / C[2, 3]
    )


@given(seeds)
def test_the_regressor_is_linear_in_the_parameters_and_gives_the_depth_weighted_projection_error(
    seed,
):
    random = make_random(seed)
    p = draw_tool_positions(random, 1)[0]
    a, _ = extract_parameters(draw_calibration_matrix(random, p[None]))
    m = project(a, p)
    assert np.allclose(build_regressor(m, p) @ a, m)
    a_hat = a * random.uniform(0.8, 1.2, 9)
    error = build_regressor(m, p) @ a_hat - m
    assert np.allclose(
        error, compute_depth(a_hat, p) * (project(a_hat, p) - m), rtol=1e-9, atol=1e-9
    )


def compute_rank(random, positions, both=False):
    """Return the rank of M with its columns scaled to one size, because their units differ."""
    C = draw_calibration_matrix(random, positions)
    A, _ = build_equations(make_observation_rows(C, positions), extract_parameters(C)[1], both)
    scale = 1 / np.sqrt(np.diag(A))
    eigenvalues = np.linalg.eigvalsh(scale[:, None] * A * scale)
    return int(np.sum(eigenvalues > 1e-12 * eigenvalues[-1]))


def draw_coplanar_positions(random, count, through_the_rcm):
    normal = random.standard_normal(3)
    normal /= np.linalg.norm(normal)
    positions = draw_tool_positions(random, count)
    distance = 0.0 if through_the_rcm else random.uniform(40, 70)
    return positions - np.outer(positions @ normal - distance, normal)


twelve_seeds = pytest.mark.parametrize("seed", range(12))


@twelve_seeds
def test_five_generic_positions_determine_all_nine_parameters_and_four_do_not(seed):
    random = make_random(seed)
    positions = draw_tool_positions(random, 5, spread=40)
    assert compute_rank(random, positions) == 9
    assert compute_rank(random, positions[:4]) == 8


@twelve_seeds
def test_coplanar_positions_leave_one_parameter_undetermined(seed):
    random = make_random(seed)
    assert compute_rank(random, draw_coplanar_positions(random, 30, through_the_rcm=False)) == 8


@twelve_seeds
@pytest.mark.parametrize("both", [False, True])
def test_positions_in_a_plane_with_the_rcm_leave_three_parameters_undetermined(seed, both):
    """The second marker of a tool through the RCM is in the same plane and adds no information."""
    random = make_random(seed)
    assert (
        compute_rank(random, draw_coplanar_positions(random, 30, through_the_rcm=True), both) == 6
    )


@twelve_seeds
def test_marker_2_determines_the_parameter_that_coplanar_positions_leave_undetermined(seed):
    """The positions p₂ of a rigid tool leave the plane of the positions p₁."""
    random = make_random(seed)
    assert (
        compute_rank(random, draw_coplanar_positions(random, 30, through_the_rcm=False), both=True)
        == 9
    )
