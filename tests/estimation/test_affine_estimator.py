"""The affine estimator: exact at any RCM depth, consistent with noise, empty without sizes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import SHAFT, SPACING_MM, differentiate, make_laboratory, make_random, seeds
from rcmservo.cli.cli import main
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.estimation.ball_size_fit import project_ball
from rcmservo.estimation.base import Sample
from rcmservo.geometry.features import FEATURE_SCALE, compute_features, shift_to_rcm
from rcmservo.geometry.tool import RigidTool, compute_second_marker
from rcmservo.interfaces import Floats

TOOL, AFFINE = RigidTool(SPACING_MM), AffineEstimator()
RADII = np.array([3.0, 4.0])
"""Radii of the two balls in mm, which no estimator knows."""

depths = st.sampled_from([-0.5, -0.05, 0.0, 0.05, 1.0])
"""Depths of the RCM as fractions of the tool's depth.

The RCM is behind the camera, on its image plane, and in front of it.
"""


def camera(random: np.random.Generator, middle: Floats, rcm_depth: float) -> Floats:
    """Return the calibration matrix C (3, 4) of a camera that looks at `middle` (3,) mm.

    Its last row is the depth in mm.
    """
    distance = random.uniform(50.0, 65.0)
    along = middle / np.linalg.norm(middle)
    across = np.cross(along, random.standard_normal(3))
    cosine = distance * (1.0 - rcm_depth) / np.linalg.norm(middle)
    forward = cosine * along + np.sqrt(1.0 - cosine**2) * across / np.linalg.norm(across)
    right = np.cross(forward, random.standard_normal(3))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 240.0], [0.0, 0.0, 1.0]])
    return K @ np.column_stack([rotation, -rotation @ (middle - distance * forward)])


def random_positions(random: np.random.Generator, count: int) -> Floats:
    """Return p₁ (count, 3) mm in a cloud of ±10 mm at a distance from the RCM."""
    direction = random.standard_normal(3)
    return 120.0 * direction / np.linalg.norm(direction) + random.uniform(-10.0, 10.0, (count, 3))


def project_balls(C: Floats, p1: Floats) -> tuple[Floats, Floats]:
    """Return the markers (2, 2) px and their radii (2,) px: focal length · radius / depth."""
    w = np.column_stack([np.stack([p1, compute_second_marker(SHAFT, p1)]), np.ones(2)]) @ C.T
    return w[:, :2] / w[:, 2:], 700.0 * RADII / w[:, 2]


def samples(
    C: Floats, positions: Floats, random: np.random.Generator, noise: float = 0.0
) -> Iterator[Sample]:
    """Return frames at the positions (n, 3), with `noise` px of centres and sizes."""
    for p1 in positions:
        points, sizes = project_balls(C, p1)
        points = points + noise * random.standard_normal((2, 2))
        sizes = sizes + noise * random.standard_normal(2)
        yield Sample(p1, points, np.zeros(2), 1.0 / 60.0, sizes)


def fit_frames(frames: Iterator[Sample], estimator: AffineEstimator = AFFINE) -> Any:
    memory = estimator.init()
    for sample in frames:
        memory = estimator.update(memory, TOOL, sample)
    return memory


def exact_fit(seed: int, depth: float) -> tuple[Floats, Floats, Any]:
    """Return a camera, 40 positions, and the memory after exact images of them."""
    random = make_random(seed)
    positions = random_positions(random, 40)
    C = camera(random, positions.mean(axis=0), depth)
    return C, positions, fit_frames(samples(C, positions, random))


@given(seeds, depths)
def test_exact_images_determine_the_twelve_numbers_of_each_ball_at_any_rcm_depth(
    seed: int, depth: float
) -> None:
    C, positions, memory = exact_fit(seed, depth)
    for k, p_0 in enumerate((positions[0], compute_second_marker(SHAFT, positions[0]))):
        shifted = C.copy()
        shifted[:2] -= np.outer(project_balls(C, positions[0])[0][k], C[2])
        expected = shifted @ np.column_stack(
            [np.vstack([100.0 * np.eye(3), np.zeros(3)]), [*p_0, 1]]
        )
        expected /= 700.0 * RADII[k]
        deviation = np.abs(memory[k]["C"] - expected).max(axis=1) / np.abs(expected).max(axis=1)
        assert deviation.max() < 2e-3


@given(seeds, depths)
def test_exact_images_determine_the_jacobian_at_any_rcm_depth(seed: int, depth: float) -> None:
    C, positions, memory = exact_fit(seed, depth)
    points, o_c = project_balls(C, positions[-1])[0], make_random(seed).uniform(-200.0, 800.0, 2)
    J = differentiate(
        lambda p: compute_features(shift_to_rcm(project_balls(C, p)[0], o_c)), positions[-1], 1e-2
    )
    J_hat = AFFINE.jacobian(memory, TOOL, Sample(positions[-1], points, o_c, 0.0))
    assert np.linalg.norm((J_hat - J) / FEATURE_SCALE[:, None]) < 5e-3 * np.linalg.norm(
        J / FEATURE_SCALE[:, None]
    )


@given(seeds, depths)
def test_the_derivative_of_the_sizes_is_that_of_the_fit_and_of_the_camera(
    seed: int, depth: float
) -> None:
    C, positions, memory = exact_fit(seed, depth)
    motion = AFFINE.sizes_jacobian(
        memory, TOOL, Sample(positions[-1], *project_balls(C, positions[-1])[:1], positions[0], 0.0)
    )
    fitted = differentiate(lambda p: fitted_sizes(memory, p), positions[-1], 1e-2)
    np.testing.assert_allclose(motion, fitted, rtol=0.0, atol=1e-7 * np.abs(fitted).max())
    true = differentiate(lambda p: project_balls(C, p)[1], positions[-1], 1e-2)
    assert np.linalg.norm(motion - true) < 5e-3 * np.linalg.norm(true)


def fitted_sizes(memory: Any, p1: Floats) -> Floats:
    """Return the radii (2,) px of both balls by the fits."""
    both = p1, compute_second_marker(SHAFT, p1)
    return np.array([1.0 / project_ball(memory[k], p).inverse_radius for k, p in enumerate(both)])


@given(seeds)
def test_it_predicts_the_markers_from_the_imaged_rcm(seed: int) -> None:
    C, positions, memory = exact_fit(seed, 1.0)
    o_c, _ = AFFINE.imaged_rcm(memory) or (np.full(2, np.nan), None)
    np.testing.assert_allclose(o_c, C[:2, 3] / C[2, 3], atol=3.0)
    m = AFFINE.predict(memory, TOOL, positions[3])
    assert m is not None
    np.testing.assert_allclose(m.reshape(2, 2) + o_c, project_balls(C, positions[3])[0], atol=0.05)


@given(seeds)
def test_the_position_error_by_one_ball_is_that_of_the_noise(seed: int) -> None:
    """Monte Carlo against Σ = H⁻¹ H⁻ᵀ σ², with H the true ∂(u, v, R)/∂p."""
    random, noise = make_random(seed), 0.1
    positions = random_positions(random, 400)
    C, p1 = camera(random, positions.mean(axis=0), 1.0), positions[-1]
    memory = fit_frames(samples(C, positions, random, noise), AffineEstimator(size_noise=1.0))
    for k in range(2):
        p = p1 if k == 0 else compute_second_marker(SHAFT, p1)
        estimates = [
            AFFINE.position(memory, k, frame.points[k], frame.sizes[k])
            for frame in samples(C, np.tile(p1, (400, 1)), random, noise)
        ]
        H = differentiate(lambda p, k=k: true_pixels_and_radius(C, p, k), p, 1e-2)
        expected = noise * np.sqrt(np.trace(np.linalg.inv(H.T @ H)))
        error = np.sqrt(np.mean(np.sum((np.array(estimates) - p) ** 2, axis=1)))
        assert error == pytest.approx(expected, rel=0.25)


def true_pixels_and_radius(C: Floats, p: Floats, k: int) -> Floats:
    """Return (u, v, R) in px of ball k at p (3,) mm."""
    w = C @ [*p, 1.0]
    return np.array([w[0] / w[2], w[1] / w[2], 700.0 * RADII[k] / w[2]])


def test_the_covariance_of_the_imaged_rcm_is_that_of_its_scatter() -> None:
    random, squares = make_random(4), []
    positions, estimator = random_positions(random, 200), AffineEstimator(size_noise=1.0)
    C = camera(random, positions.mean(axis=0), 0.8)
    for _ in range(100):
        estimates = estimator.imaged_rcm(fit_frames(samples(C, positions, random, 0.2), estimator))
        assert estimates is not None
        error = estimates[0] - C[:2, 3] / C[2, 3]
        squares.append(error @ np.linalg.solve(estimates[1], error))
    assert 1.0 < np.mean(squares) < 3.5, "2 on average, and less for the more certain of two fits"


@pytest.mark.parametrize("lost_marker", [0, 1])
def test_with_one_marker_lost_the_other_determines_the_position(lost_marker: int) -> None:
    random, memory = make_random(1), AFFINE.init()
    positions = random_positions(random, 60)
    C = camera(random, positions.mean(axis=0), 0.5)
    for sample in samples(C, positions, random, 0.05):
        points = sample.points.copy()
        points[lost_marker] = np.nan
        memory = AFFINE.update(memory, TOOL, sample._replace(points=points))
    points, sizes = project_balls(C, positions[0])
    p = AFFINE.position(memory, 1 - lost_marker, points[1 - lost_marker], sizes[1 - lost_marker])
    assert p is not None
    expected = compute_second_marker(SHAFT, positions[0]) if lost_marker == 0 else positions[0]
    assert np.linalg.norm(p - expected) < 0.5
    assert AFFINE.position(memory, lost_marker, points[lost_marker], sizes[lost_marker]) is None
    assert AFFINE.position(memory, 1 - lost_marker, np.full(2, np.nan), 20.0) is None
    assert AFFINE.position(memory, 1 - lost_marker, points[1 - lost_marker], 0.0) is None
    assert AFFINE.predict(memory, TOOL, positions[0]) is None
    assert not AFFINE.jacobian(memory, TOOL, sample).any()


def test_without_sizes_it_estimates_nothing() -> None:
    random, memory = make_random(2), AFFINE.init()
    positions = random_positions(random, 30)
    for sample in samples(camera(random, positions.mean(axis=0), 0.5), positions, random):
        without_sizes = Sample(*sample[:4])
        memory = AFFINE.update(memory, TOOL, without_sizes)
    assert memory.tobytes() == AFFINE.init().tobytes()
    assert not AFFINE.jacobian(memory, TOOL, without_sizes).any()
    assert AFFINE.imaged_rcm(memory) is None and AFFINE.predict(memory, TOOL, positions[0]) is None


def test_a_run_with_a_tracker_without_sizes_ends_with_advice() -> None:
    lab = make_laboratory()
    servo = lab.servo(estimator=AFFINE)
    for _, state in lab.run(servo, 30.0):
        assert np.isfinite(state.command.rates).all() and not state.J_hat.any()
        if state.phase is rs.Phase.FAULT:
            break
    assert state.cause is rs.Cause.NOT_EXPLORED and "apparent sizes" in state.detail


@pytest.mark.slow
def test_on_rendered_images_it_reaches_the_target_and_replays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = [
        "run",
        "--seed",
        "0",
        "--estimator",
        "affine",
        "--duration",
        "6",
        "--no-video",
        "--teaching-frames",
        "30",
    ]
    assert main([*run, "--json", "--out", str(tmp_path / "run")]) == 0
    assert json.loads(capsys.readouterr().out)["pose_error_mm"] < 0.25
    assert main(["replay", str(tmp_path / "run")]) == 0
    assert "the same, bit for bit" in capsys.readouterr().out


@given(seeds)
def test_an_update_leaves_the_previous_memory_unchanged(seed: int) -> None:
    random = make_random(seed)
    positions = random_positions(random, 3)
    C, memory = camera(random, positions.mean(axis=0), 0.5), AFFINE.init()
    for sample in samples(C, positions, random, 0.1):
        before = memory.tobytes()
        after = AFFINE.update(memory, TOOL, sample)
        assert memory.tobytes() == before != after.tobytes()
        assert np.isfinite(AFFINE.jacobian(after, TOOL, sample)).all()
        memory = after


@pytest.mark.parametrize("value", [0, -1, 1e-3, 1e3, np.nan])
def test_a_setting_outside_its_range_is_refused_by_name(value: float) -> None:
    with pytest.raises(rs.BadInput, match=r"estimator\.size_noise"):
        AffineEstimator(size_noise=value)
