"""Scenes of a seed: they never change, because studies of other versions use the same ones."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import ROOT
from rcmservo.errors import BadInput
from rcmservo.geometry.features import FEATURE_SCALE
from rcmservo.sim import RigSettings, SceneSettings
from rcmservo.sim.ground_truth import compute_true_jacobian_at_joints
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.feasibility import SceneFeasibility
from rcmservo.sim.scenes.joint_paths import compute_imaged_rcm
from rcmservo.sim.tool_body import ToolBody

SETTINGS = RigSettings()
BODY = ToolBody(SETTINGS.mechanism, SETTINGS.tool)
FEASIBILITY = SceneFeasibility(SETTINGS.scene, BODY, max(SETTINGS.appearance.marker_radii))
HARD = SceneSettings(min_condition=40.0, max_condition=1e9)


def worst_condition(scene: Scene) -> float:
    """Return the largest condition number of the scaled true Jacobian on the path."""
    o_c = compute_imaged_rcm(scene.optics)
    jacobians = [compute_true_jacobian_at_joints(BODY, scene.optics, q, o_c) for q in scene.path]
    return max(float(np.linalg.cond(J / FEATURE_SCALE[:, None])) for J in jacobians)


def test_the_scenes_of_forty_seeds_are_those_of_version_0_2_0() -> None:
    for line in (ROOT / "tests/data/scenes.csv").read_text().splitlines()[1:]:
        seed, rejected, *numbers = line.split(",")
        scene, _ = sample_scene_of_seed(int(seed), SETTINGS)
        optics = scene.optics
        numbers_now = [*scene.start, *scene.target, *optics.position, optics.focal, *optics.centre]
        assert scene.rejected == int(rejected)
        np.testing.assert_allclose(numbers_now, np.array(numbers, float), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_scene_is_infeasible_if_its_camera_turns_or_its_path_meets_a_limit(seed: int) -> None:
    scene, _ = sample_scene_of_seed(seed, SETTINGS)
    optics = scene.optics
    assert FEASIBILITY.is_feasible(scene)
    aside = replace(scene, optics=replace(optics, centre=optics.centre + np.array([0.0, 400.0])))
    behind = replace(scene, optics=replace(optics, position=-optics.position))
    far = replace(scene, path=scene.path + np.array([0.0, 0.0, 200.0]))
    assert not any(FEASIBILITY.is_feasible(other) for other in (aside, behind, far))


@pytest.mark.parametrize("seed", range(5))
def test_max_condition_bounds_that_of_the_true_jacobian_along_the_path(seed: int) -> None:
    scene, _ = sample_scene_of_seed(seed, SETTINGS)
    worst = worst_condition(scene)
    for factor, expected in ((1.0 + 1e-9, True), (1.0 - 1e-9, False)):
        settings = replace(SETTINGS.scene, max_condition=factor * worst)
        assert (
            SceneFeasibility(settings, BODY, 4.0).is_well_conditioned(scene.optics, scene.path)
            == expected
        )
        beyond = replace(HARD, min_condition=factor * worst)
        assert (
            SceneFeasibility(beyond, BODY, 4.0).is_well_conditioned(scene.optics, scene.path)
            != expected
        )


@pytest.mark.parametrize("seed", range(5))
def test_only_its_condition_makes_a_hard_scene_infeasible_by_default(seed: int) -> None:
    scene, _ = sample_scene_of_seed(seed, replace(SETTINGS, scene=HARD))
    assert worst_condition(scene) > SETTINGS.scene.max_condition
    unlimited = replace(FEASIBILITY, settings=replace(SETTINGS.scene, max_condition=1e9))
    assert unlimited.is_feasible(scene) and not FEASIBILITY.is_feasible(scene)


@pytest.mark.parametrize("least", [-1.0, 40.0, np.nan, np.inf])
def test_an_impossible_condition_is_refused_in_one_sentence(least: float) -> None:
    with pytest.raises(BadInput, match=r"scene\.min_condition must be a number from 0 to below"):
        SceneSettings(min_condition=least)


def test_without_an_imaged_rcm_no_path_is_well_conditioned() -> None:
    scene, _ = sample_scene_of_seed(0, SETTINGS)
    beyond = replace(scene.optics, position=10.0 * scene.optics.rotation[2])
    assert np.isnan(compute_imaged_rcm(beyond)).all() and not FEASIBILITY.is_well_conditioned(
        beyond, scene.path
    )


def test_an_impossible_seed_is_refused_in_one_sentence() -> None:
    with pytest.raises(BadInput, match="seed must be"):
        sample_scene_of_seed(-1, SETTINGS)
