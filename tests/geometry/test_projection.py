"""Lemma 1: nine parameters are all of C that the RCM's picture needs, and which tool positions
determine them.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import equations, observed, random_from, seeds, seen_by, tool_positions, true_camera
from rcmservo.geometry.projection import PARAMETERS, depth, parameters, project, regressor


@given(seeds)
def test_nine_parameters_recover_the_picture_of_any_calibration_matrix(seed):
    random = random_from(seed)
    places = tool_positions(random, 8)
    C = true_camera(random, places)
    a, o_c = parameters(C)
    assert a.shape == (PARAMETERS,)
    for p, seen in zip(places, seen_by(C, places), strict=True):
        assert np.allclose(project(a, p) + o_c, seen, rtol=0, atol=1e-8)


@given(seeds, st.floats(-1e6, 1e6).filter(lambda scale: abs(scale) > 1e-6))
def test_the_scale_of_the_calibration_matrix_does_not_matter_nor_its_sign(seed, scale):
    random = random_from(seed)
    C = true_camera(random, tool_positions(random, 3))
    for got, wanted in zip(parameters(scale * C), parameters(C), strict=True):
        assert np.allclose(got, wanted, rtol=1e-12)


@given(seeds)
def test_shifting_the_pixel_origin_moves_the_imaged_rcm_and_no_parameter(seed):
    random = random_from(seed)
    C = true_camera(random, tool_positions(random, 3))
    shift = random.uniform(-500, 500, 2)
    shifted = C + np.outer(np.append(shift, 0.0), C[2])
    (a, o_c), (a_shifted, o_c_shifted) = parameters(C), parameters(shifted)
    assert np.allclose(a_shifted, a, rtol=1e-9, atol=1e-11)
    assert np.allclose(o_c_shifted, o_c + shift)


@given(seeds)
def test_the_rcm_projects_to_the_origin_at_depth_one(seed):
    random = random_from(seed)
    C = true_camera(random, tool_positions(random, 3))
    a, o_c = parameters(C)
    assert np.array_equal(project(a, np.zeros(3)), np.zeros(2))
    assert depth(a, np.zeros(3)) == 1.0
    assert np.allclose(o_c, seen_by(C, np.zeros((1, 3)))[0])


@given(seeds)
def test_depth_is_the_cameras_depth_over_that_of_the_rcm(seed):
    random = random_from(seed)
    p = tool_positions(random, 1)[0]
    C = true_camera(random, p[None])
    assert depth(parameters(C)[0], p) == pytest.approx((C[2, :3] @ p + C[2, 3]) / C[2, 3])


@given(seeds)
def test_the_regressor_is_linear_in_the_parameters_and_gives_the_depth_weighted_projection_error(
    seed,
):
    random = random_from(seed)
    p = tool_positions(random, 1)[0]
    a, _ = parameters(true_camera(random, p[None]))
    m = project(a, p)
    assert np.allclose(regressor(m, p) @ a, m)
    a_hat = a * random.uniform(0.8, 1.2, 9)
    error = regressor(m, p) @ a_hat - m
    assert np.allclose(error, depth(a_hat, p) * (project(a_hat, p) - m), rtol=1e-9, atol=1e-9)


def rank(random, places, both=False):
    """The rank of M, columns scaled to one size first: they have different units."""
    C = true_camera(random, places)
    A, _ = equations(observed(C, places), parameters(C)[1], both)
    scale = 1 / np.sqrt(np.diag(A))
    eigenvalues = np.linalg.eigvalsh(scale[:, None] * A * scale)
    return int(np.sum(eigenvalues > 1e-12 * eigenvalues[-1]))


def in_a_plane(random, count, through_the_rcm):
    normal = random.standard_normal(3)
    normal /= np.linalg.norm(normal)
    places = tool_positions(random, count)
    distance = 0.0 if through_the_rcm else random.uniform(40, 70)
    return places - np.outer(places @ normal - distance, normal)


many = pytest.mark.parametrize("seed", range(12))


@many
def test_five_generic_positions_determine_all_nine_parameters_and_four_do_not(seed):
    random = random_from(seed)
    places = tool_positions(random, 5, spread=40)
    assert rank(random, places) == 9
    assert rank(random, places[:4]) == 8


@many
def test_any_number_of_coplanar_positions_leaves_one_parameter_open(seed):
    random = random_from(seed)
    assert rank(random, in_a_plane(random, 30, through_the_rcm=False)) == 8


@many
@pytest.mark.parametrize("both", [False, True])
def test_positions_in_a_plane_with_the_rcm_leave_three_parameters_open_with_both_markers_too(
    seed, both
):
    """The second marker of a tool through the RCM is in that plane as well: it cannot help."""
    random = random_from(seed)
    assert rank(random, in_a_plane(random, 30, through_the_rcm=True), both) == 6


@many
def test_the_second_marker_determines_what_coplanar_first_markers_leave_open(seed):
    """The rigid tool's p₂ leave the plane of the p₁."""
    random = random_from(seed)
    assert rank(random, in_a_plane(random, 30, through_the_rcm=False), both=True) == 9
