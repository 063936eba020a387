"""By places and sizes: exact from exact pictures wherever the RCM is, as near as the noise lets it,
with one marker too; and without sizes it says that it knows nothing.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcmservo as rs
from conftest import SHAFT, SPACING, derivative, laboratory, random_from, seeds
from rcmservo.cli.cli import main
from rcmservo.estimation.affine import AffineEstimator
from rcmservo.estimation.ball_size_fit import project_ball
from rcmservo.estimation.base import Sample
from rcmservo.geometry.features import SCALE, about, features
from rcmservo.geometry.tool import RigidTool, second_marker
from rcmservo.interfaces import Floats

TOOL, AFFINE = RigidTool(SPACING), AffineEstimator()
RADII = np.array([3.0, 4.0])
"""mm of the two balls, which no estimator is told."""

depths = st.sampled_from([-0.5, -0.05, 0.0, 0.05, 1.0])
"""Of the RCM, as shares of the tool's: behind the camera, on its image plane, before it."""


def camera(random: np.random.Generator, middle: Floats, rcm_depth: float) -> Floats:
    """A calibration matrix C (3, 4), whose last row is the depth in mm, of a camera that looks at
    `middle` (3,) mm.
    """
    away = random.uniform(50.0, 65.0)
    along = middle / np.linalg.norm(middle)
    across = np.cross(along, random.standard_normal(3))
    cosine = away * (1.0 - rcm_depth) / np.linalg.norm(middle)
    forward = cosine * along + np.sqrt(1.0 - cosine**2) * across / np.linalg.norm(across)
    right = np.cross(forward, random.standard_normal(3))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[700.0, 0.0, 320.0], [0.0, 700.0, 240.0], [0.0, 0.0, 1.0]])
    return K @ np.column_stack([rotation, -rotation @ (middle - away * forward)])


def places(random: np.random.Generator, count: int) -> Floats:
    """p₁ (count, 3) mm in a cloud of ±10 mm that keeps away from the RCM."""
    way = random.standard_normal(3)
    return 120.0 * way / np.linalg.norm(way) + random.uniform(-10.0, 10.0, (count, 3))


def seen(C: Floats, p1: Floats) -> tuple[Floats, Floats]:
    """The markers (2, 2) px and their apparent radii (2,) px: focal length, radius, depth."""
    w = np.column_stack([np.stack([p1, second_marker(SHAFT, p1)]), np.ones(2)]) @ C.T
    return w[:, :2] / w[:, 2:], 700.0 * RADII / w[:, 2]


def samples(
    C: Floats, way: Floats, random: np.random.Generator, noise: float = 0.0
) -> Iterator[Sample]:
    """Frames at the places `way` (n, 3), with `noise` px of centres and sizes."""
    for p1 in way:
        points, sizes = seen(C, p1)
        points = points + noise * random.standard_normal((2, 2))
        sizes = sizes + noise * random.standard_normal(2)
        yield Sample(p1, points, np.zeros(2), 1.0 / 60.0, sizes)


def taught(frames: Iterator[Sample], estimator: AffineEstimator = AFFINE) -> Any:
    memory = estimator.init()
    for sample in frames:
        memory = estimator.update(memory, TOOL, sample)
    return memory


def exact(seed: int, depth: float) -> tuple[Floats, Floats, Any]:
    """A camera, 40 places, and what exact pictures of them teach."""
    random = random_from(seed)
    way = places(random, 40)
    C = camera(random, way.mean(axis=0), depth)
    return C, way, taught(samples(C, way, random))


@given(seeds, depths)
def test_exact_pictures_teach_the_twelve_numbers_of_each_ball_wherever_the_rcm_is(
    seed: int, depth: float
) -> None:
    C, way, memory = exact(seed, depth)
    for k, p_0 in enumerate((way[0], second_marker(SHAFT, way[0]))):
        shifted = C.copy()
        shifted[:2] -= np.outer(seen(C, way[0])[0][k], C[2])
        wanted = shifted @ np.column_stack([np.vstack([100.0 * np.eye(3), np.zeros(3)]), [*p_0, 1]])
        wanted /= 700.0 * RADII[k]
        apart = np.abs(memory[k]["C"] - wanted).max(axis=1) / np.abs(wanted).max(axis=1)
        assert apart.max() < 2e-3


@given(seeds, depths)
def test_exact_pictures_teach_the_jacobian_wherever_the_rcm_is(seed: int, depth: float) -> None:
    C, way, memory = exact(seed, depth)
    points, o_c = seen(C, way[-1])[0], random_from(seed).uniform(-200.0, 800.0, 2)
    J = derivative(lambda p: features(about(seen(C, p)[0], o_c)), way[-1], 1e-2)
    J_hat = AFFINE.jacobian(memory, TOOL, Sample(way[-1], points, o_c, 0.0))
    assert np.linalg.norm((J_hat - J) / SCALE[:, None]) < 5e-3 * np.linalg.norm(J / SCALE[:, None])


@given(seeds, depths)
def test_how_sizes_change_is_what_the_fit_says_nearby_and_what_is_true(
    seed: int, depth: float
) -> None:
    C, way, memory = exact(seed, depth)
    motion = AFFINE.size_motion(memory, TOOL, Sample(way[-1], *seen(C, way[-1])[:1], way[0], 0.0))
    fitted = derivative(lambda p: sizes_by_fit(memory, p), way[-1], 1e-2)
    np.testing.assert_allclose(motion, fitted, rtol=0.0, atol=1e-7 * np.abs(fitted).max())
    true = derivative(lambda p: seen(C, p)[1], way[-1], 1e-2)
    assert np.linalg.norm(motion - true) < 5e-3 * np.linalg.norm(true)


def sizes_by_fit(memory: Any, p1: Floats) -> Floats:
    """(2,) px that the fits have of both balls' radii."""
    both = p1, second_marker(SHAFT, p1)
    return np.array([1.0 / project_ball(memory[k], p).inverse_radius for k, p in enumerate(both)])


@given(seeds)
def test_it_foretells_the_markers_from_the_imaged_rcm(seed: int) -> None:
    C, way, memory = exact(seed, 1.0)
    o_c, _ = AFFINE.imaged_rcm(memory) or (np.full(2, np.nan), None)
    np.testing.assert_allclose(o_c, C[:2, 3] / C[2, 3], atol=3.0)
    m = AFFINE.predict(memory, TOOL, way[3])
    assert m is not None
    np.testing.assert_allclose(m.reshape(2, 2) + o_c, seen(C, way[3])[0], atol=0.05)


@given(seeds)
def test_the_place_it_tells_by_one_ball_is_off_by_what_the_noise_must_do(seed: int) -> None:
    """Monte Carlo against Σ = H⁻¹ H⁻ᵀ σ², H the true derivative of u, v and size by the place."""
    random, noise = random_from(seed), 0.1
    way = places(random, 400)
    C, p1 = camera(random, way.mean(axis=0), 1.0), way[-1]
    memory = taught(samples(C, way, random, noise), AffineEstimator(size_noise=1.0))
    for k in range(2):
        p = p1 if k == 0 else second_marker(SHAFT, p1)
        told = [
            AFFINE.position(memory, k, frame.points[k], frame.sizes[k])
            for frame in samples(C, np.tile(p1, (400, 1)), random, noise)
        ]
        H = derivative(lambda p, k=k: by_numbers(C, p, k), p, 1e-2)
        wanted = noise * np.sqrt(np.trace(np.linalg.inv(H.T @ H)))
        off = np.sqrt(np.mean(np.sum((np.array(told) - p) ** 2, axis=1)))
        assert off == pytest.approx(wanted, rel=0.25)


def by_numbers(C: Floats, p: Floats, k: int) -> Floats:
    """(u, v, R) px of ball k at p (3,) mm."""
    w = C @ [*p, 1.0]
    return np.array([w[0] / w[2], w[1] / w[2], 700.0 * RADII[k] / w[2]])


def test_the_covariance_of_the_imaged_rcm_is_that_of_its_scatter() -> None:
    random, surprises = random_from(4), []
    way, estimator = places(random, 200), AffineEstimator(size_noise=1.0)
    C = camera(random, way.mean(axis=0), 0.8)
    for _ in range(100):
        told = estimator.imaged_rcm(taught(samples(C, way, random, 0.2), estimator))
        assert told is not None
        off = told[0] - C[:2, 3] / C[2, 3]
        surprises.append(off @ np.linalg.solve(told[1], off))
    assert 1.0 < np.mean(surprises) < 3.5, "2 on average, less as the better of two is taken"


@pytest.mark.parametrize("lost", [0, 1])
def test_with_one_marker_lost_the_other_still_tells_the_place(lost: int) -> None:
    random, memory = random_from(1), AFFINE.init()
    way = places(random, 60)
    C = camera(random, way.mean(axis=0), 0.5)
    for sample in samples(C, way, random, 0.05):
        points = sample.points.copy()
        points[lost] = np.nan
        memory = AFFINE.update(memory, TOOL, sample._replace(points=points))
    points, sizes = seen(C, way[0])
    p = AFFINE.position(memory, 1 - lost, points[1 - lost], sizes[1 - lost])
    assert p is not None
    wanted = second_marker(SHAFT, way[0]) if lost == 0 else way[0]
    assert np.linalg.norm(p - wanted) < 0.5
    assert AFFINE.position(memory, lost, points[lost], sizes[lost]) is None
    assert AFFINE.position(memory, 1 - lost, np.full(2, np.nan), 20.0) is None
    assert AFFINE.position(memory, 1 - lost, points[1 - lost], 0.0) is None
    assert AFFINE.predict(memory, TOOL, way[0]) is None
    assert not AFFINE.jacobian(memory, TOOL, sample).any()


def test_without_sizes_it_says_that_nothing_is_known() -> None:
    random, memory = random_from(2), AFFINE.init()
    way = places(random, 30)
    for sample in samples(camera(random, way.mean(axis=0), 0.5), way, random):
        blind = Sample(*sample[:4])
        memory = AFFINE.update(memory, TOOL, blind)
    assert memory.tobytes() == AFFINE.init().tobytes()
    assert not AFFINE.jacobian(memory, TOOL, blind).any()
    assert AFFINE.imaged_rcm(memory) is None and AFFINE.predict(memory, TOOL, way[0]) is None


def test_with_a_tracker_that_tells_no_sizes_a_run_ends_with_what_it_lacks() -> None:
    lab = laboratory()
    servo = lab.servo(estimator=AFFINE)
    for _, state in lab.run(servo, 30.0):
        assert np.isfinite(state.command.rates).all() and not state.J_hat.any()
        if state.phase is rs.Phase.FAULT:
            break
    assert state.cause is rs.Cause.NOT_EXPLORED and "apparent sizes" in state.detail


@pytest.mark.slow
def test_on_rendered_pictures_it_settles_at_the_target_and_replays(
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
def test_an_update_changes_nothing_that_was_remembered(seed: int) -> None:
    random = random_from(seed)
    way = places(random, 3)
    C, memory = camera(random, way.mean(axis=0), 0.5), AFFINE.init()
    for sample in samples(C, way, random, 0.1):
        before = memory.tobytes()
        after = AFFINE.update(memory, TOOL, sample)
        assert memory.tobytes() == before != after.tobytes()
        assert np.isfinite(AFFINE.jacobian(after, TOOL, sample)).all()
        memory = after


@pytest.mark.parametrize("value", [0, -1, 1e-3, 1e3, np.nan])
def test_a_setting_that_cannot_work_is_refused_by_name(value: float) -> None:
    with pytest.raises(rs.BadInput, match=r"estimator\.size_noise"):
        AffineEstimator(size_noise=value)
