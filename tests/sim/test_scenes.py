"""A seed is a scene for ever: studies of other versions were made in the same ones."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import ROOT
from rcmservo.errors import BadInput
from rcmservo.method.features import SCALE
from rcmservo.sim import RigSettings
from rcmservo.sim.body import Body
from rcmservo.sim.rig import drawn
from rcmservo.sim.scenes.fitness import Fitness
from rcmservo.sim.scenes.ways import imaged_rcm
from rcmservo.sim.truth import feature_jacobian

SETTINGS = RigSettings()
BODY = Body(SETTINGS.mechanism, SETTINGS.tool)
FITNESS = Fitness(SETTINGS.scene, BODY, max(SETTINGS.look.marker_radii))


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
    o_c = imaged_rcm(scene.optics)
    jacobians = [feature_jacobian(BODY, scene.optics, q, o_c) for q in scene.way]
    worst = max(np.linalg.cond(J / SCALE[:, None]) for J in jacobians)
    for share, right in ((1.0 + 1e-9, True), (1.0 - 1e-9, False)):
        asked = replace(SETTINGS.scene, max_condition=share * worst)
        assert Fitness(asked, BODY, 4.0).regular(scene.optics, scene.way) == right


def test_where_the_camera_does_not_see_the_rcm_nothing_is_regular() -> None:
    scene, _ = drawn(0, SETTINGS)
    beyond = replace(scene.optics, position=10.0 * scene.optics.rotation[2])
    assert np.isnan(imaged_rcm(beyond)).all() and not FITNESS.regular(beyond, scene.way)


def test_a_seed_that_cannot_be_is_one_sentence() -> None:
    with pytest.raises(BadInput, match="seed must be"):
        drawn(-1, SETTINGS)
