"""A seed is a scene for ever: studies of other versions were made in the same ones."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import ROOT
from rcmservo.errors import BadInput
from rcmservo.method.features import SCALE
from rcmservo.sim import RigSettings, SceneSettings
from rcmservo.sim.ground_truth import feature_jacobian
from rcmservo.sim.rig import drawn
from rcmservo.sim.scene import Scene
from rcmservo.sim.scenes.feasibility import Fitness
from rcmservo.sim.scenes.joint_paths import imaged_rcm
from rcmservo.sim.tool_body import Body

SETTINGS = RigSettings()
BODY = Body(SETTINGS.mechanism, SETTINGS.tool)
FITNESS = Fitness(SETTINGS.scene, BODY, max(SETTINGS.look.marker_radii))
HARD = SceneSettings(min_condition=40.0, max_condition=1e9)


def worst_condition(scene: Scene) -> float:
    """The largest of the scaled true Jacobian on the way."""
    o_c = imaged_rcm(scene.optics)
    jacobians = [feature_jacobian(BODY, scene.optics, q, o_c) for q in scene.way]
    return max(float(np.linalg.cond(J / SCALE[:, None])) for J in jacobians)


def test_the_scenes_of_forty_seeds_are_those_of_version_0_2_0() -> None:
    for line in (ROOT / "tests/data/scenes.csv").read_text().splitlines()[1:]:
        seed, rejected, *numbers = line.split(",")
        scene, _ = drawn(int(seed), SETTINGS)
        optics = scene.optics
        now = [*scene.start, *scene.target, *optics.position, optics.focal, *optics.centre]
        assert scene.rejected == int(rejected)
        np.testing.assert_allclose(now, np.array(numbers, float), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_scene_suits_until_its_camera_turns_away_or_the_way_runs_into_a_limit(seed: int) -> None:
    scene, _ = drawn(seed, SETTINGS)
    optics = scene.optics
    assert FITNESS.suits(scene)
    aside = replace(scene, optics=replace(optics, centre=optics.centre + np.array([0.0, 400.0])))
    behind = replace(scene, optics=replace(optics, position=-optics.position))
    far = replace(scene, way=scene.way + np.array([0.0, 0.0, 200.0]))
    assert not any(FITNESS.suits(other) for other in (aside, behind, far))


@pytest.mark.parametrize("seed", range(5))
def test_the_condition_asked_for_bounds_that_of_the_true_jacobian_along_the_way(seed: int) -> None:
    scene, _ = drawn(seed, SETTINGS)
    worst = worst_condition(scene)
    for share, right in ((1.0 + 1e-9, True), (1.0 - 1e-9, False)):
        asked = replace(SETTINGS.scene, max_condition=share * worst)
        assert Fitness(asked, BODY, 4.0).regular(scene.optics, scene.way) == right
        beyond = replace(HARD, min_condition=share * worst)
        assert Fitness(beyond, BODY, 4.0).regular(scene.optics, scene.way) != right


@pytest.mark.parametrize("seed", range(5))
def test_a_hard_scene_is_one_that_only_its_condition_bars_from_the_usual_ones(seed: int) -> None:
    scene, _ = drawn(seed, replace(SETTINGS, scene=HARD))
    assert worst_condition(scene) > SETTINGS.scene.max_condition
    unlimited = replace(FITNESS, settings=replace(SETTINGS.scene, max_condition=1e9))
    assert unlimited.suits(scene) and not FITNESS.suits(scene)


@pytest.mark.parametrize("least", [-1.0, 40.0, np.nan, np.inf])
def test_a_condition_that_no_scene_has_is_one_sentence(least: float) -> None:
    with pytest.raises(BadInput, match=r"scene\.min_condition must be a number from 0 to below"):
        SceneSettings(min_condition=least)


def test_where_the_camera_does_not_see_the_rcm_nothing_is_regular() -> None:
    scene, _ = drawn(0, SETTINGS)
    beyond = replace(scene.optics, position=10.0 * scene.optics.rotation[2])
    assert np.isnan(imaged_rcm(beyond)).all() and not FITNESS.regular(beyond, scene.way)


def test_a_seed_that_cannot_be_is_one_sentence() -> None:
    with pytest.raises(BadInput, match="seed must be"):
        drawn(-1, SETTINGS)
