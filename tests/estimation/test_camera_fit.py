"""The projection fit: predictions with a consistent covariance, from noisy frames too."""

import numpy as np
import pytest
from hypothesis import given

from conftest import (
    SHAFT,
    SPACING_MM,
    differentiate,
    draw_calibration_matrix,
    draw_tool_positions,
    make_random,
    project_markers,
    project_points,
    seeds,
    snapshot,
)
from rcmservo.estimation.camera_fit import (
    MIN_FRAME_SPACING_MM,
    PRIOR_NOISE_FRAMES,
    RCM_POSITION_MM,
    ProjectionFit,
    make_initial_fit,
    project_point,
    reset_fit,
    update_fit,
)
from rcmservo.estimation.camera_fit_prediction import (
    compute_fitted_features_jacobian,
    compute_markers_jacobian,
    compute_pose_deviation,
    compute_spacing_covariance,
    filter_markers,
    predict_image,
    predict_markers,
    write_point_jacobian,
)
from rcmservo.geometry.features import compute_features, shift_to_rcm
from rcmservo.geometry.tool import compute_second_marker
from rcmservo.interfaces import Floats

CHI_SQUARE_95 = 5.991
"""95 % quantile of xᵀ cov⁻¹ x of two coordinates."""

FAR_POSITION_MM = np.array([-1.0, 1.0, 60.0])
"""Offset (mm) to a position far from all frames of a narrow cloud."""


def tips(positions: Floats) -> Floats:
    """Return p₂ (n, 3) mm of p₁ (n, 3)."""
    return positions * (1.0 + SPACING_MM / np.linalg.norm(positions, axis=1))[:, None]


def project_path(C: Floats, positions: Floats) -> Floats:
    """Return the raw pixels (n, 2, 2) of both markers."""
    return np.stack([project_points(C, positions), project_points(C, tips(positions))], axis=1)


def fit_frames(positions: Floats, points: Floats) -> ProjectionFit:
    fit = make_initial_fit()
    row = fit.rows[0]
    for p1, markers in zip(positions, points, strict=True):
        update_fit(row, p1, markers, SHAFT)
    return fit


class Scene:
    """A camera, and a tool in `frames` positions within ±`spread` mm."""

    def __init__(self, seed: int, frames: int, spread: float = 6.0) -> None:
        self.random = make_random(seed)
        self.positions = draw_tool_positions(self.random, frames, spread)
        self.middle = self.positions.mean(axis=0)
        self.C = draw_calibration_matrix(self.random, self.positions[:20])

    def noisy_images(self, noise: float) -> Floats:
        exact = project_path(self.C, self.positions)
        return exact + noise * self.random.standard_normal(exact.shape)

    def fit_frames(self, noise: float) -> ProjectionFit:
        return fit_frames(self.positions, self.noisy_images(noise))


def prediction_error(fit: ProjectionFit, C: Floats, p: Floats) -> tuple[Floats, float]:
    """Return the error (2,) px of the predicted image of p, and its normalised square."""
    point, covariance = predict_image(fit.rows[0], p)
    error = point - project_points(C, p[None])[0]
    return error, float(error @ np.linalg.solve(covariance, error))


def spacing_error(fit: ProjectionFit, C: Floats, p1: Floats) -> float:
    """Return the normalised square of the error of the predicted vector between the markers."""
    row, p2 = fit.rows[0], compute_second_marker(SHAFT, p1)
    vector = predict_image(row, p2)[0] - predict_image(row, p1)[0]
    error = vector - np.subtract(project_points(C, p2[None])[0], project_points(C, p1[None])[0])
    image_1, image_2 = project_point(row, p1), project_point(row, p2)
    uu, uv, vv = compute_spacing_covariance(row, image_1, image_2)
    return float(error @ np.linalg.solve([[uu, uv], [uv, vv]], error))


def random_fit(seed: int) -> tuple[ProjectionFit, Floats]:
    """Return a random projection, and a position p₁ in front of its camera."""
    random = make_random(seed)
    p1 = draw_tool_positions(random, 1)[0]
    fit = ProjectionFit.of(
        A=100.0 * random.standard_normal((2, 4)),
        g=random.uniform(-0.2, 0.2, 3),
        origin=[*(p1 + random.uniform(-20.0, 20.0, 3)), 300.0, 200.0],
        offset=random.standard_normal((2, 2)),
    )
    return fit, p1


@given(seeds)
def test_the_jacobian_is_the_derivative_of_the_prediction(seed: int) -> None:
    fit, p1 = random_fit(seed)
    row = fit.rows[0]
    expected_jacobian = differentiate(lambda p: predict_image(row, p)[0], p1, 1e-2)
    jacobian = np.empty((2, 3))
    write_point_jacobian(row, project_point(row, p1), jacobian)
    np.testing.assert_allclose(jacobian, expected_jacobian, rtol=1e-6, atol=1e-8)
    expected_jacobian = differentiate(lambda p: predict_markers(row, p, SHAFT).ravel(), p1, 1e-2)
    np.testing.assert_allclose(
        compute_markers_jacobian(row, p1, SHAFT), expected_jacobian, rtol=1e-6, atol=1e-8
    )


@given(seeds)
def test_the_features_jacobian_is_the_derivative_of_the_features(seed: int) -> None:
    fit, p1 = random_fit(seed)
    row, o_c = fit.rows[0], make_random(seed).uniform(-900.0, -300.0, 2)
    points = predict_markers(row, p1, SHAFT)
    expected_jacobian = differentiate(
        lambda p: compute_features(shift_to_rcm(predict_markers(row, p, SHAFT), o_c)), p1, 1e-3
    )
    J = compute_fitted_features_jacobian(row, p1, points, o_c, SHAFT)
    np.testing.assert_allclose(
        J, expected_jacobian, rtol=1e-4, atol=1e-6 * np.abs(expected_jacobian).max()
    )


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_the_predicted_covariance_is_consistent_near_the_frames_and_far_from_them(
    noise: float,
) -> None:
    near_squares, far_squares, spacing_squares = [], [], []
    for seed in range(100):
        scene = Scene(seed, 60)
        fit = scene.fit_frames(noise)
        for p1 in scene.positions[:2]:
            far = scene.middle + 3.0 * (p1 - scene.middle)
            for squares, point in ((near_squares, p1), (far_squares, far)):
                squares += [
                    prediction_error(fit, scene.C, p)[1]
                    for p in (point, compute_second_marker(SHAFT, point))
                ]
                spacing_squares.append(spacing_error(fit, scene.C, point))
    for squares in (near_squares, far_squares, spacing_squares):
        assert 0.90 < np.mean(np.array(squares) < CHI_SQUARE_95) < 0.99


@pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
def test_the_noise_is_estimated_once_the_frames_outweigh_the_prior(
    noise: float,
) -> None:
    frames = round(200 * PRIOR_NOISE_FRAMES)
    variances = [Scene(seed, frames).fit_frames(noise).noise_variance for seed in range(10)]
    assert np.mean(variances) == pytest.approx(noise**2, rel=0.15)


def biased(scenes: int, frames: int, spread: float) -> tuple[Floats, Floats]:
    """Return the relative radial error of the imaged RCM in every scene, and its normalised square.

    The noise is 0.3 px.
    """
    relative_errors, squares = [], []
    for seed in range(scenes):
        scene = Scene(seed, frames, spread)
        error, squared = prediction_error(scene.fit_frames(0.3), scene.C, RCM_POSITION_MM)
        relative_errors.append(relative_error(scene, error))
        squares.append(squared)
    return np.array(relative_errors), np.array(squares)


def relative_error(scene: Scene, error: Floats) -> float:
    """Return the radial component of an error (2,) px, as a fraction of the radial distance.

    The radial direction is that from the tool to the imaged RCM.
    """
    direction = (
        project_points(scene.C, RCM_POSITION_MM[None])[0]
        - project_points(scene.C, scene.middle[None])[0]
    )
    return float(error @ direction / (direction @ direction))


@pytest.mark.parametrize(
    "scenes,frames", [(150, 300), pytest.param(120, 2_500, marks=pytest.mark.slow)]
)
def test_the_imaged_rcm_is_not_biased_and_its_covariance_covers_its_error(
    scenes: int, frames: int
) -> None:
    """A cloud of ±6 mm corresponds to ±3° of a tool that is 115 mm deep."""
    relative_errors, squares = biased(scenes, frames, 6.0)
    assert abs(np.mean(relative_errors)) < 0.01
    assert 0.90 < np.mean(squares < CHI_SQUARE_95) < 0.99


def least_squares_rcm(positions: Floats, points: Floats) -> Floats:
    """Return the imaged RCM (2,) px by plain least squares of the same equations."""
    middle, m_0 = positions.mean(axis=0), points.mean(axis=(0, 1))
    both = np.concatenate([positions, tips(positions)])
    x = np.column_stack([(both - middle) / 100.0, np.ones(len(both))])
    m, none = points.transpose(1, 0, 2).reshape(-1, 2) - m_0, np.zeros_like(x)
    rows = [
        np.column_stack([x, none, -m[:, :1] * x[:, :3]]),
        np.column_stack([none, x, -m[:, 1:] * x[:, :3]]),
    ]
    h = np.linalg.lstsq(np.concatenate(rows), m.T.ravel(), rcond=None)[0]
    rcm = np.append((RCM_POSITION_MM - middle) / 100.0, 1.0)
    return m_0 + h[:8].reshape(2, 4) @ rcm / (1.0 + h[8:] @ rcm[:3])


def test_without_the_correction_for_noise_the_imaged_rcm_is_biased_towards_the_tool() -> None:
    """With ±3 mm (±1.5°) and 1 px of noise the bias is a sixth of the distance."""
    uncorrected, corrected = [], []
    for seed in range(30):
        scene = Scene(seed, 500, 3.0)
        points, true_rcm = (
            scene.noisy_images(1.0),
            project_points(scene.C, RCM_POSITION_MM[None])[0],
        )
        uncorrected.append(
            relative_error(scene, least_squares_rcm(scene.positions, points) - true_rcm)
        )
        error, _ = prediction_error(fit_frames(scene.positions, points), scene.C, RCM_POSITION_MM)
        corrected.append(relative_error(scene, error))
    assert np.median(uncorrected) < -0.1
    assert abs(np.median(corrected)) < 0.05


def test_a_motion_too_short_to_determine_the_denominator_does_not_make_it_large() -> None:
    for seed in range(20):
        scene = Scene(seed, 100, 0.5)
        assert np.linalg.norm(scene.fit_frames(0.5).g) < 2.0


@given(seeds)
def test_the_standard_deviation_of_the_pose_follows_the_textbook_formula(seed: int) -> None:
    scene = Scene(seed, 40)
    fit, p1 = scene.fit_frames(0.3), scene.positions[0]
    H = compute_markers_jacobian(fit.rows[0], p1, SHAFT)
    pose = fit.noise_variance * np.trace(np.linalg.inv(H.T @ H))
    assert compute_pose_deviation(fit.rows[0], p1, SHAFT) == pytest.approx(np.sqrt(pose))


def test_at_rest_the_offset_averages_the_noise_and_the_sums_stay() -> None:
    scene = Scene(5, 60)
    fit, p1 = scene.fit_frames(0.0), scene.positions[-1]
    row, sums, exact = fit.rows[0], fit.sums.copy(), project_markers(scene.C, scene.positions[-1])
    for noise in 0.3 * scene.random.standard_normal((200, 2, 2)):
        update_fit(row, p1, exact + noise, SHAFT)
    assert np.abs(filter_markers(row, p1, SHAFT) - exact).max() < 4.0 * 0.3 / np.sqrt(200)
    assert np.array_equal(fit.sums, sums)


def test_positions_closer_than_the_spacing_count_once() -> None:
    p1, fit = np.array([10.0, 20.0, -120.0]), make_initial_fit()
    for distance, frames in (
        (0.0, 1),
        (0.9 * MIN_FRAME_SPACING_MM, 1),
        (1.1 * MIN_FRAME_SPACING_MM, 2),
        (1.2 * MIN_FRAME_SPACING_MM, 2),
    ):
        update_fit(fit.rows[0], p1 + np.array([distance, 0.0, 0.0]), np.eye(2), SHAFT)
        assert fit.frame_count == frames


def test_one_frame_determines_the_markers_and_nothing_more() -> None:
    scene = Scene(1, 1)
    p1, points = scene.positions[0], project_path(scene.C, scene.positions)[0]
    row = fit_frames(scene.positions, points[None]).rows[0]
    np.testing.assert_allclose(filter_markers(row, p1, SHAFT), points, atol=1e-9)
    covariance = predict_image(row, p1 + FAR_POSITION_MM)[1]
    assert covariance.trace() > 100.0**2


def test_before_the_first_frame_nothing_is_predicted() -> None:
    row = make_initial_fit().rows[0]
    assert np.isnan(predict_markers(row, FAR_POSITION_MM, SHAFT)).all()


def test_a_reset_fit_is_as_before_the_first_frame() -> None:
    fit = Scene(0, 10).fit_frames(0.3)
    reset_fit(fit.rows[0])
    assert snapshot(fit) == snapshot(make_initial_fit())
