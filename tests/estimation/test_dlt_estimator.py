"""The direct linear transformation: exact at any RCM depth, and averages the markers' noise.

The tests of its projection fit are in test_camera_fit.py.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conftest import SHAFT, SPACING_MM, differentiate, make_random, seeds, snapshot
from rcmservo.estimation.base import Estimator, Sample
from rcmservo.estimation.camera_fit import ProjectionFit
from rcmservo.estimation.dlt import DltEstimator
from rcmservo.estimation.projection_rule import ProjectionEstimator
from rcmservo.geometry.features import FEATURE_SCALE, compute_features, shift_to_rcm
from rcmservo.geometry.tool import RigidTool, compute_second_marker
from rcmservo.interfaces import Floats

TOOL = RigidTool(SPACING_MM)
DLT = DltEstimator()

depths = st.sampled_from([-0.5, -0.05, 0.05, 1.0])
"""Depths of the RCM as fractions of the tool's depth.

The RCM is behind the camera, near its image plane, and in front of it.
"""


def camera(random: np.random.Generator, middle: Floats, rcm_depth: float) -> Floats:
    """Return the calibration matrix C (3, 4) of a camera that looks at `middle` (3,) mm."""
    distance = random.uniform(45.0, 75.0)
    across = np.cross(middle, random.standard_normal(3))
    across /= np.linalg.norm(across)
    along = middle / np.linalg.norm(middle)
    cosine = distance * (1.0 - rcm_depth) / np.linalg.norm(middle)
    forward = cosine * along + np.sqrt(1.0 - cosine**2) * across
    right = np.cross(forward, random.standard_normal(3))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 240.0], [0.0, 0.0, 1.0]])
    return K @ np.column_stack([rotation, -rotation @ (middle - distance * forward)])


def project_markers(C: Floats, p1: Floats) -> Floats:
    points = np.column_stack([np.stack([p1, compute_second_marker(SHAFT, p1)]), np.ones(2)]) @ C.T
    return points[:, :2] / points[:, 2:]


def random_positions(random: np.random.Generator, count: int) -> Floats:
    """Return p₁ (count, 3) mm in a cloud of ±15 mm at a distance from the RCM."""
    direction = random.standard_normal(3)
    return 120.0 * direction / np.linalg.norm(direction) + random.uniform(-15.0, 15.0, (count, 3))


def fitted_jacobian(
    estimator: Estimator, C: Floats, positions: Floats, noise: Floats, o_c: Floats
) -> Floats:
    """Return the scaled Ĵ (3, 3) at the last of the positions (n, 3), with `noise` (n, 2, 2) px."""
    memory = estimator.init()
    for p1, offset in zip(positions, noise, strict=True):
        sample = Sample(p1, project_markers(C, p1) + offset, o_c, 1.0 / 60.0)
        memory = estimator.update(memory, TOOL, sample)
    exact = Sample(positions[-1], project_markers(C, positions[-1]), o_c, 1.0 / 60.0)
    return estimator.jacobian(memory, TOOL, exact) / FEATURE_SCALE[:, None]


def true_jacobian(C: Floats, p1: Floats, o_c: Floats) -> Floats:
    return (
        differentiate(
            lambda p: compute_features(shift_to_rcm(project_markers(C, p), o_c)), p1, 1e-2
        )
        / FEATURE_SCALE[:, None]
    )


@given(seeds, depths)
def test_exact_images_determine_the_jacobian_at_any_rcm_depth(seed: int, depth: float) -> None:
    random = make_random(seed)
    positions = random_positions(random, 40)
    C, o_c = camera(random, positions.mean(axis=0), depth), random.uniform(-200.0, 800.0, 2)
    J = true_jacobian(C, positions[-1], o_c)
    J_hat = fitted_jacobian(DLT, C, positions, np.zeros((40, 2, 2)), o_c)
    assert np.linalg.norm(J_hat - J) < 0.02 * np.linalg.norm(J)


def test_nine_parameters_about_the_rcm_fail_with_the_rcm_behind_the_camera() -> None:
    """With the RCM in front of the camera that estimator works in the same scene."""
    errors = {}
    for depth in (-0.5, 1.0):
        random = make_random(3)
        positions = random_positions(random, 40)
        C = camera(random, positions.mean(axis=0), depth)
        o_c = (C[:, 3] / C[2, 3])[:2]
        J = true_jacobian(C, positions[-1], o_c)
        J_hat = fitted_jacobian(ProjectionEstimator(), C, positions, np.zeros((40, 2, 2)), o_c)
        errors[depth] = np.linalg.norm(J_hat - J) / np.linalg.norm(J)
    assert errors[-0.5] > 0.3 and errors[1.0] < 0.05


@given(seeds)
def test_an_error_of_the_imaged_rcm_does_not_affect_it(seed: int) -> None:
    random = make_random(seed)
    positions, noise = random_positions(random, 100), 0.3 * random.standard_normal((100, 2, 2))
    C, errors = camera(random, positions.mean(axis=0), 0.3), []
    for offset in (np.zeros(2), np.array([30.0, 40.0])):
        o_c = (C[:, 3] / C[2, 3])[:2] + offset
        J = true_jacobian(C, positions[-1], o_c)
        J_hat = fitted_jacobian(DLT, C, positions, noise, o_c)
        errors.append(np.linalg.norm(J_hat - J) / np.linalg.norm(J))
    assert max(errors) < 0.05


def filtered_markers(noise: Floats, bias: float = 0.0) -> tuple[Floats, Floats]:
    """Return the filtered and the true markers of a tool at rest, in frames with this noise."""
    random = make_random(5)
    positions = random_positions(random, 40)
    C, o_c, memory = camera(random, positions.mean(axis=0), 1.0), np.zeros(2), DLT.init()
    for p1 in positions:
        memory = DLT.update(memory, TOOL, Sample(p1, project_markers(C, p1), o_c, 0.0))
    points = project_markers(C, positions[-1]) + bias
    for offset in noise:
        sample = Sample(positions[-1], points + offset, o_c, 0.0)
        memory = DLT.update(memory, TOOL, sample)
    return DLT.filtered_markers(memory, TOOL, sample), points


def test_at_rest_it_averages_the_noise_of_the_markers() -> None:
    noise = 0.3 * make_random(0).standard_normal((200, 2, 2))
    located, points = filtered_markers(noise)
    assert np.abs(located - points).max() < 4.0 * 0.3 / np.sqrt(200)


def test_the_offset_follows_the_residuals_of_the_fit() -> None:
    """The camera has moved by 2 px: the offset takes that in over the frames of its mean."""
    located, points = filtered_markers(np.zeros((1000, 2, 2)), bias=2.0)
    assert np.abs(located - points).max() < 0.1
    early, _ = filtered_markers(np.zeros((1, 2, 2)), bias=2.0)
    assert np.abs(early - points).max() > 0.5


def test_one_frame_determines_only_the_direction_of_the_imaged_tool() -> None:
    random = make_random(1)
    p1 = random_positions(random, 1)[0]
    points = project_markers(camera(random, p1, 1.0), p1)
    sample = Sample(p1, points, np.zeros(2), 0.0)
    memory = DLT.update(DLT.init(), TOOL, sample)
    strengths = np.linalg.svd(DLT.jacobian(memory, TOOL, sample) / FEATURE_SCALE[:, None])[1]
    assert strengths[1] < 1e-3 * strengths[0]
    np.testing.assert_allclose(DLT.filtered_markers(memory, TOOL, sample), points, atol=1e-9)


@given(seeds, depths)
def test_the_imaged_rcm_is_estimated_in_front_of_behind_and_near_the_image_plane(
    seed: int, depth: float
) -> None:
    random = make_random(seed)
    positions, memory = random_positions(random, 40), DLT.init()
    C = camera(random, positions.mean(axis=0), depth)
    for p1 in positions:
        memory = DLT.update(
            memory, TOOL, Sample(p1, project_markers(C, p1), np.full(2, np.nan), 0.0)
        )
    o_c, covariance = DLT.imaged_rcm(memory)
    expected, tool_image = (C[:, 3] / C[2, 3])[:2], project_markers(C, positions[-1])[0]
    assert np.linalg.norm(o_c - expected) < 0.02 * np.linalg.norm(expected - tool_image)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


@given(seeds)
def test_predictions_are_the_markers_from_the_imaged_rcm(seed: int) -> None:
    random = make_random(seed)
    positions, memory = random_positions(random, 40), DLT.init()
    C = camera(random, positions.mean(axis=0), 1.0)
    for p1 in positions:
        memory = DLT.update(memory, TOOL, Sample(p1, project_markers(C, p1), np.zeros(2), 0.0))
    expected = (project_markers(C, positions[0]) - (C[:, 3] / C[2, 3])[:2]).ravel()
    assert (
        np.abs(DLT.predict(memory, TOOL, positions[0]) - expected).max()
        < 0.05 * np.abs(expected).max()
    )


def test_an_update_leaves_the_previous_memory_unchanged() -> None:
    p1_first, p1_second = random_positions(make_random(0), 2)
    memory = DLT.update(DLT.init(), TOOL, Sample(p1_first, np.ones((2, 2)), np.zeros(2), 0.0))
    before = snapshot(ProjectionFit(memory))
    after = DLT.update(memory, TOOL, Sample(p1_second, np.ones((2, 2)), np.zeros(2), 0.0))
    assert snapshot(ProjectionFit(memory)) == before != snapshot(ProjectionFit(after))
