"""True camera: projection, its inverse and derivative, and sphere silhouettes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_random, seeds
from rcmservo.errors import BadInput
from rcmservo.sim.camera_kernels import project
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation

POSITION = np.array([-70.0, -60.0, 20.0])
TARGET = np.array([0.0, 0.0, -110.0])
UP = np.array([0.0, 0.0, 5.0])


def camera(k1=-0.15, k2=0.03, focal=700.0, roll=0.3):
    rotation = compute_look_at_rotation(POSITION, TARGET, roll)
    return CameraModel(
        640, 480, focal, np.array([322.0, 236.0]), np.array([k1, k2]), rotation, POSITION
    )


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(700, 1500))
def test_a_point_on_a_pixels_ray_projects_to_that_pixel(k1, k2, focal):
    optics = camera(k1, k2, focal)
    rays = optics.rays()[::37, ::41].reshape(-1, 3)
    assert np.allclose(np.linalg.norm(rays, axis=1), 1)
    back = optics.project(optics.position + 120 * rays)
    assert np.abs(back - optics.pixels()[::37, ::41].reshape(-1, 2)).max() < 1e-6


def test_the_target_of_look_at_is_at_the_principal_point_and_up_is_up():
    optics = camera(roll=0.0)
    image = optics.project(np.stack([TARGET, TARGET + UP]))
    assert np.allclose(image[0], optics.centre)
    assert image[1, 0] == pytest.approx(image[0, 0])
    assert image[1, 1] < image[0, 1]


def test_rolling_the_camera_clockwise_turns_the_picture_anticlockwise():
    up = camera(roll=np.pi / 2).project((TARGET + UP)[None])[0]
    assert up[0] < 322.0 - 10
    assert up[1] == pytest.approx(236.0)


def test_looking_straight_down_is_no_special_case():
    rotation = compute_look_at_rotation(np.zeros(3), np.array([0.0, 0.0, -1.0]))
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_depth_is_the_distance_along_the_line_of_sight():
    assert camera().depth(TARGET[None])[0] == pytest.approx(np.linalg.norm(TARGET - POSITION))


def test_points_behind_or_far_aside_have_no_image():
    optics = camera(k1=-0.3, k2=0.0)
    aside = optics.position + 50 * (optics.rotation[2] + 1.2 * optics.rotation[0])
    behind = 2 * POSITION - TARGET
    assert np.isnan(optics.project(np.array([behind, aside, POSITION]))).all()
    assert np.isfinite(optics.project(TARGET[None])).all()


@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(-160, -60))
def test_the_jacobian_is_the_derivative_of_the_distorted_projection(x, y, z):
    optics, point, h = camera(), np.array([x, y, z]), 1e-3
    steps = h * np.eye(3)
    numeric = (optics.project(point + steps) - optics.project(point - steps)).T / (2 * h)
    assert np.allclose(optics.project_jacobian(point), numeric, atol=1e-6)


@given(seeds)
def test_compiled_functions_project_as_the_camera_does(seed):
    random, optics = make_random(seed), camera(k1=-0.3)
    points = optics.position + random.uniform(-300.0, 300.0, (20, 3))
    images = [project(optics.lens[0], p) for p in points]
    np.testing.assert_allclose(images, optics.project(points), rtol=1e-9)


@pytest.mark.parametrize(("k1", "k2", "turns"), [(-0.3, 0.02, 1), (-0.08, 0.02, 0), (0.1, 0.0, 0)])
def test_the_lens_folds_where_its_distorted_radius_turns(k1, k2, turns):
    fold = camera(k1, k2, focal=1500.0).fold
    assert np.isfinite(fold) == turns
    if turns:
        assert 1 + 3 * k1 * fold**2 + 5 * k2 * fold**4 == pytest.approx(0.0, abs=1e-12)


def test_on_the_axis_a_spheres_outline_is_a_circle_about_its_centre():
    optics = camera(k1=0.0, k2=0.0)
    Z, R = np.linalg.norm(TARGET - POSITION), 4.0
    assert np.allclose(optics.silhouette_centre(TARGET, R), optics.centre)
    assert optics.silhouette_radius(TARGET, R) == pytest.approx(
        700 * R / np.sqrt(Z**2 - R**2), rel=2e-4
    )


def test_off_the_axis_perspective_pulls_the_centroid_outwards_by_the_known_amount():
    optics = CameraModel(
        640, 480, 700.0, np.array([320.0, 240.0]), np.zeros(2), np.eye(3), np.zeros(3)
    )
    centre, R = np.array([40.0, -25.0, 100.0]), 5.0
    image = optics.project(centre[None])[0]
    expected = image + (image - optics.centre) * R**2 / (100.0**2 - R**2)
    assert np.allclose(optics.silhouette_centre(centre, R), expected, atol=1e-6)


def test_a_sphere_around_or_behind_the_camera_has_no_silhouette():
    optics = camera()
    assert np.isnan(optics.silhouette_centre(POSITION, 5.0)).all()
    assert np.isnan(optics.silhouette_centre(2 * POSITION - TARGET, 5.0)).all()
    assert np.isnan(optics.silhouette_radius(POSITION, 5.0))


def test_without_distortion_the_calibration_matrix_projects_as_the_camera_does():
    optics = camera(0.0, 0.0)
    positions = np.random.default_rng(0).uniform(-20.0, 20.0, (10, 3)) + TARGET
    image = np.column_stack([positions, np.ones(10)]) @ optics.pinhole().T
    np.testing.assert_allclose(image[:, :2] / image[:, 2:], optics.project(positions), atol=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0},
        {"focal": -700.0},
        {"focal": np.nan},
        {"centre": np.zeros(3)},
        {"distortion": np.array([-2.0, 0.0])},
        {"rotation": -np.eye(3)},
        {"position": np.array([0.0, np.inf, 0.0])},
    ],
)
def test_impossible_geometry_is_refused_in_one_sentence(change):
    valid = {
        "width": 640,
        "height": 480,
        "focal": 700.0,
        "centre": np.array([320.0, 240.0]),
        "distortion": np.zeros(2),
        "rotation": np.eye(3),
        "position": np.zeros(3),
    }
    CameraModel(**valid)
    with pytest.raises(BadInput, match=f"{next(iter(change))} must be"):
        CameraModel(**(valid | change))


def test_a_camera_cannot_look_at_itself():
    with pytest.raises(BadInput):
        compute_look_at_rotation(POSITION, POSITION)
