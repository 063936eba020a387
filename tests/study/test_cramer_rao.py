"""Cramér-Rao bound: the least-squares fit of the pose reaches it, other fits stay above it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import rcmservo as rs
from conftest import differentiate
from rcmservo.errors import BadInput
from rcmservo.geometry.tool import RigidTool, ScaledTool, Tool
from rcmservo.interfaces import Floats
from rcmservo.sim import RigSettings
from rcmservo.sim.cramer_rao import compute_pixels_jacobian
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm

NOISE_PX, FRAMES, TAUGHT_FRAMES = 0.3, 60, 30
DRAWS = 4000
"""Number of errors whose rms has a standard deviation of about 1 %."""

SCENES = range(20)


def sample_scene(seed: int, tool: Tool = RigidTool(30.0)) -> Scene:  # noqa: B008
    return sample_scene_of_seed(seed, RigSettings(tool=tool))[0]


def pixels(scene: Scene, p2: Floats) -> Floats:
    """Return the pixels of both markers (N, 4) with marker 2 at p2 (N, 3), mm."""
    tool, rho = scene.body.tool, np.linalg.norm(p2, axis=1, keepdims=True)
    p1 = p2 * (1.0 - tool.value / rho) if isinstance(tool, RigidTool) else p2 / tool.value
    return np.column_stack([scene.optics.project(p1), scene.optics.project(p2)])


def features(scene: Scene, m: Floats) -> Floats:
    """Return [s r d] (N, 3) about the true imaged RCM, with s relative to the target."""
    o_c, axis = compute_imaged_rcm(scene.optics), m[:, 2:] - m[:, :2]
    m_d = pixels(scene, target(scene)[None])[0]
    angle = np.arctan2(axis[:, 1], axis[:, 0]) - np.arctan2(*(m_d[2:] - m_d[:2])[::-1])
    s = (angle + np.pi) % (2.0 * np.pi) - np.pi
    r, d = np.linalg.norm(m[:, :2] - o_c, axis=1), np.linalg.norm(axis, axis=1)
    return np.column_stack([s, r, d])


def target(scene: Scene) -> Floats:
    return scene.body.points(scene.target)[1]


def fit_positions(measured: Floats, predict: Callable[[Floats], Floats], start: Floats) -> Floats:
    """Fit positions (N, 3) to measurements (N, k) by Gauss-Newton."""
    p, step = np.tile(start, (len(measured), 1)), 1e-3 * np.eye(3)
    for _ in range(3):
        J = np.stack([predict(p + h) - predict(p - h) for h in step], axis=-1) / 2e-3
        gradient = J.swapaxes(1, 2) @ (measured - predict(p))[..., None]
        p = p + np.linalg.solve(J.swapaxes(1, 2) @ J, gradient)[..., 0]
    return p


def draw_errors(scene: Scene, measure: Callable[[Scene, Floats], Floats]) -> Floats:
    """Return errors (DRAWS, 3) mm: the pose fitted to present frames minus that to taught frames.

    The fit uses what `measure` computes from the averaged pixels.
    """
    random, p = np.random.default_rng(0), target(scene)
    poses = []
    for frames in (FRAMES, TAUGHT_FRAMES):
        noise = random.standard_normal((DRAWS, 4)) * NOISE_PX / np.sqrt(frames)
        measured = measure(scene, pixels(scene, p[None]) + noise)
        poses.append(fit_positions(measured, lambda p2: measure(scene, pixels(scene, p2)), p))
    return poses[0] - poses[1]


def rms(errors: Floats) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


@pytest.mark.parametrize("tool", [RigidTool(30.0, offset=5.0), ScaledTool(1.3)])
def test_the_jacobian_is_that_of_both_markers_by_the_position_of_marker_2(tool: Tool) -> None:
    for seed in range(5):
        scene = sample_scene(seed, tool)
        H = differentiate(lambda p, scene=scene: pixels(scene, p[None])[0], target(scene), 1e-2)
        np.testing.assert_allclose(compute_pixels_jacobian(scene), H, atol=1e-7)
        covariance = rs.bound(scene, NOISE_PX, FRAMES, TAUGHT_FRAMES).covariance
        expected = NOISE_PX**2 * (1 / FRAMES + 1 / TAUGHT_FRAMES) * np.linalg.inv(H.T @ H)
        np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("seed", SCENES)
def test_the_least_squares_fit_of_averaged_pixels_reaches_the_bound(seed: int) -> None:
    scene = sample_scene(seed)
    errors, least = (
        draw_errors(scene, lambda _, m: m),
        rs.bound(scene, NOISE_PX, FRAMES, TAUGHT_FRAMES),
    )
    assert rms(errors) == pytest.approx(least.rms, rel=0.05)
    axes = np.linalg.eigh(least.covariance)
    spread = np.sqrt(np.mean((errors @ axes[1]) ** 2, axis=0))
    np.testing.assert_allclose(spread, np.sqrt(axes[0]), rtol=0.05)


def test_a_fit_of_the_features_stays_above_the_bound() -> None:
    """[s r d] are three of four numbers. In some scenes the fourth has no information."""
    scenes = [sample_scene(seed) for seed in SCENES]
    errors = np.array([rms(draw_errors(scene, features)) for scene in scenes])
    ratios = errors / [rs.bound(scene, NOISE_PX, FRAMES, TAUGHT_FRAMES).rms for scene in scenes]
    assert ratios.min() > 0.95 and np.mean(ratios > 1.1) > 0.7
    assert 1.2 < np.median(ratios) < 1.6


def test_the_bound_grows_with_noise_and_falls_with_the_square_root_of_the_frames() -> None:
    scene = sample_scene(0)
    single = rs.bound(scene, NOISE_PX, 1).rms
    assert rs.bound(scene, 2.0 * NOISE_PX, 4).rms == pytest.approx(single)
    assert rs.bound(scene, NOISE_PX, 1, np.inf).rms == pytest.approx(single / np.sqrt(2.0))
    assert rs.bound(scene, 0.0, 1).rms == 0.0


def test_markers_farther_apart_lower_the_bound() -> None:
    scene = sample_scene(0)
    body = type(scene.body)(scene.body.mechanism, RigidTool(60.0))
    assert (
        rs.bound(replace(scene, body=body), NOISE_PX, 1).rms
        < 0.8 * rs.bound(scene, NOISE_PX, 1).rms
    )


@pytest.mark.parametrize(
    ("arguments", "name"),
    [((-0.1, 30), "noise"), ((np.nan, 30), "noise"), ((0.3, 0), "frames"), ((0.3, 1, 0), "shown")],
)
def test_an_invalid_argument_raises_an_error_that_names_it(
    arguments: tuple[float, ...], name: str
) -> None:
    with pytest.raises(BadInput, match=f"{name} must be"):
        rs.bound(sample_scene(0), *arguments)
