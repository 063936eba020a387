"""The Cramér-Rao bound: what the best fit of the pose reaches, and no other."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import rcmservo as rs
from conftest import derivative
from rcmservo.errors import BadInput
from rcmservo.geometry.tool import RigidTool, ScaledTool, Tool
from rcmservo.interfaces import Floats
from rcmservo.sim import RigSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm
from rcmservo.study.cramer_rao import pixels_jacobian

NOISE, SEEN, SHOWN = 0.3, 60, 30
DRAWS = 4000
"""The rms of so many errors is known to about 1 %."""

SCENES = range(20)


def scene_of(seed: int, tool: Tool = RigidTool(30.0)) -> Scene:  # noqa: B008
    return sample_scene_of_seed(seed, RigSettings(tool=tool))[0]


def pixels(scene: Scene, p2: Floats) -> Floats:
    """Both markers' pixels (N, 4), with marker 2 of the rigid tool at p2 (N, 3)."""
    tool, rho = scene.body.tool, np.linalg.norm(p2, axis=1, keepdims=True)
    p1 = p2 * (1.0 - tool.value / rho) if isinstance(tool, RigidTool) else p2 / tool.value
    return np.column_stack([scene.optics.project(p1), scene.optics.project(p2)])


def features(scene: Scene, m: Floats) -> Floats:
    """[s r d] (N, 3) about the true imaged RCM, s from where the target has it."""
    o_c, way = compute_imaged_rcm(scene.optics), m[:, 2:] - m[:, :2]
    at = pixels(scene, target(scene)[None])[0]
    turned = np.arctan2(way[:, 1], way[:, 0]) - np.arctan2(*(at[2:] - at[:2])[::-1])
    s = (turned + np.pi) % (2.0 * np.pi) - np.pi
    r, d = np.linalg.norm(m[:, :2] - o_c, axis=1), np.linalg.norm(way, axis=1)
    return np.column_stack([s, r, d])


def target(scene: Scene) -> Floats:
    return scene.body.points(scene.target)[1]


def fitted(seen: Floats, foretold: Callable[[Floats], Floats], start: Floats) -> Floats:
    """The places (N, 3) whose numbers are nearest to those seen (N, k), by Gauss-Newton."""
    p, step = np.tile(start, (len(seen), 1)), 1e-3 * np.eye(3)
    for _ in range(3):
        J = np.stack([foretold(p + h) - foretold(p - h) for h in step], axis=-1) / 2e-3
        pull = J.swapaxes(1, 2) @ (seen - foretold(p))[..., None]
        p = p + np.linalg.solve(J.swapaxes(1, 2) @ J, pull)[..., 0]
    return p


def error_of(scene: Scene, told: Callable[[Scene, Floats], Floats]) -> Floats:
    """Errors (DRAWS, 3) mm between the poses fitted to what is seen and to what was shown, each
    from what is `told` of the averaged pixels.
    """
    random, p = np.random.default_rng(0), target(scene)
    poses = []
    for frames in (SEEN, SHOWN):
        blur = random.standard_normal((DRAWS, 4)) * NOISE / np.sqrt(frames)
        seen = told(scene, pixels(scene, p[None]) + blur)
        poses.append(fitted(seen, lambda places: told(scene, pixels(scene, places)), p))
    return poses[0] - poses[1]


def rms(errors: Floats) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


@pytest.mark.parametrize("tool", [RigidTool(30.0, offset=5.0), ScaledTool(1.3)])
def test_its_derivative_is_that_of_both_markers_pixels_by_the_place_of_marker_2(tool: Tool) -> None:
    for seed in range(5):
        scene = scene_of(seed, tool)
        H = derivative(lambda p, scene=scene: pixels(scene, p[None])[0], target(scene), 1e-2)
        np.testing.assert_allclose(pixels_jacobian(scene), H, atol=1e-7)
        here = rs.bound(scene, NOISE, SEEN, SHOWN).covariance
        known = NOISE**2 * (1 / SEEN + 1 / SHOWN) * np.linalg.inv(H.T @ H)
        np.testing.assert_allclose(here, known, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("seed", SCENES)
def test_the_best_fit_of_averaged_pixels_reaches_it(seed: int) -> None:
    scene = scene_of(seed)
    errors, least = error_of(scene, lambda _, m: m), rs.bound(scene, NOISE, SEEN, SHOWN)
    assert rms(errors) == pytest.approx(least.rms, rel=0.05)
    axes = np.linalg.eigh(least.covariance)
    spread = np.sqrt(np.mean((errors @ axes[1]) ** 2, axis=0))
    np.testing.assert_allclose(spread, np.sqrt(axes[0]), rtol=0.05)


def test_a_fit_of_less_than_the_pixels_tell_stays_above_it() -> None:
    """[s r d]: three numbers of four. In some scenes the fourth tells nothing."""
    scenes = [scene_of(seed) for seed in SCENES]
    errors = np.array([rms(error_of(scene, features)) for scene in scenes])
    ratios = errors / [rs.bound(scene, NOISE, SEEN, SHOWN).rms for scene in scenes]
    assert ratios.min() > 0.95 and np.mean(ratios > 1.1) > 0.7
    assert 1.2 < np.median(ratios) < 1.6


def test_noise_and_frames_count_as_the_square_root_law_has_them() -> None:
    scene = scene_of(0)
    one = rs.bound(scene, NOISE, 1).rms
    assert rs.bound(scene, 2.0 * NOISE, 4).rms == pytest.approx(one)
    assert rs.bound(scene, NOISE, 1, np.inf).rms == pytest.approx(one / np.sqrt(2.0))
    assert rs.bound(scene, 0.0, 1).rms == 0.0


def test_markers_farther_apart_tell_more() -> None:
    scene = scene_of(0)
    body = type(scene.body)(scene.body.mechanism, RigidTool(60.0))
    assert rs.bound(replace(scene, body=body), NOISE, 1).rms < 0.8 * rs.bound(scene, NOISE, 1).rms


@pytest.mark.parametrize(
    ("choices", "name"),
    [((-0.1, 30), "noise"), ((np.nan, 30), "noise"), ((0.3, 0), "frames"), ((0.3, 1, 0), "shown")],
)
def test_what_cannot_be_is_one_sentence(choices: tuple[float, ...], name: str) -> None:
    with pytest.raises(BadInput, match=f"{name} must be"):
        rs.bound(scene_of(0), *choices)
