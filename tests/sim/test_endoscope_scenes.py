"""Scenes of an endoscope: its camera looks through its own port, wherever the RCM is."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import mark_others_slow
from rcmservo.config.rig_file import load_rig_file
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import PitchYawRcm
from rcmservo.interfaces import Floats
from rcmservo.sim import Rig, RigSettings, SceneSettings
from rcmservo.sim.rig import sample_scene_of_seed
from rcmservo.sim.rig_file import read_rig_settings
from rcmservo.sim.scene import NoScene, Scene
from rcmservo.sim.scenes.endoscope import MAX_WALL_SLOPE_RAD, MIN_INSERTED_LENGTH_MM
from rcmservo.tracking import ColourMarkers

PORTS = 70.0, 130.0
SCENE = SceneSettings(ports=PORTS, distance=(60.0, 120.0), travel=(10.0, 30.0))
SETTINGS = RigSettings(scene=SCENE)
WRIST = replace(SETTINGS, mechanism=PitchYawRcm())


def line_of_ports(scene: Scene) -> Floats:
    """Return points (N, 3) mm outwards from the lens, on which the endoscope's shaft must lie."""
    markers = np.concatenate([scene.body.points(q)[:2] for q in (scene.start, scene.target)])
    middle = markers.mean(axis=0)
    out = scene.optics.position - middle
    return scene.optics.position + np.outer(
        np.arange(MIN_INSERTED_LENGTH_MM - 0.05, 400.0, 0.1), out / np.linalg.norm(out)
    )


@pytest.mark.parametrize("settings", [SETTINGS, WRIST])
def test_the_endoscope_passes_the_wall_at_the_requested_distance(
    settings: RigSettings,
) -> None:
    for seed in range(40):
        line = line_of_ports(sample_scene_of_seed(seed, settings)[0])
        distance = np.linalg.norm(line, axis=1)
        wall = np.abs(line[:, 2]) <= distance * np.sin(MAX_WALL_SLOPE_RAD + 1e-3)
        assert (wall & (distance > PORTS[0] - 0.1) & (distance < PORTS[1] + 0.1)).any()


def test_the_rcm_is_behind_or_in_front_of_the_lens() -> None:
    optics = [sample_scene_of_seed(seed, SETTINGS)[0].optics for seed in range(40)]
    behind = [one.depth(np.zeros((1, 3)))[0] < 0.0 for one in optics]
    assert 0.25 < np.mean(behind) < 0.75


def test_travel_and_camera_distance_are_within_their_ranges() -> None:
    for seed in range(20):
        scene, _ = sample_scene_of_seed(seed, SETTINGS)
        markers = np.stack([scene.body.points(q)[:2] for q in (scene.start, scene.target)])
        assert 10.0 <= np.linalg.norm(markers[1, 0] - markers[0, 0]) <= 30.0
        assert 60.0 <= np.linalg.norm(scene.optics.position - markers.mean(axis=(0, 1))) <= 120.0


@pytest.mark.parametrize("seed", mark_others_slow(range(8)))
def test_a_tracker_finds_both_markers_in_the_images(seed: int) -> None:
    rig = Rig(seed, SETTINGS)
    for q in (rig.scene.target, rig.scene.start):
        rig.place(q)
        frame = rig.camera.latest()
        assert frame is not None
        points = ColourMarkers().find(frame).points
        np.testing.assert_allclose(points, rig.truth.pixels(q), atol=2.0)


def test_a_camera_that_cannot_image_the_rcm_can_be_relocated() -> None:
    rigs = [Rig(seed, SETTINGS, pictures=False) for seed in range(20)]
    for rig in [rig for rig in rigs if np.isnan(rig.truth.imaged_rcm()).any()][:4]:
        before = rig.truth.pixels(rig.scene.start)
        rig.relocate_camera()
        after = rig.truth.pixels(rig.scene.start)
        (a, b), (c, d) = before[1] - before[0], after[1] - after[0]
        assert np.abs(np.arctan2(a * d - b * c, a * c + b * d)) > 0.5


def test_a_camera_outside_its_port_is_no_endoscope() -> None:
    with pytest.raises(NoScene):
        sample_scene_of_seed(0, RigSettings(scene=replace(SCENE, distance=(400.0, 500.0))))


def test_a_rig_file_may_have_ports(tmp_path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text("[scene]\nports = [70.0, 130.0]\n")
    assert read_rig_settings(load_rig_file(path)).scene.ports == PORTS


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"ports": (0.0, 130.0)}, "ports must be two positive numbers"),
        ({"ports": (130.0, 70.0)}, "ports must be two positive numbers"),
        ({"ports": (70.0, np.nan)}, "ports must be two positive numbers"),
        ({"ports": PORTS, "errors": (0.3, 30.0, 20.0)}, "errors must be left out where ports"),
        ({"ports": PORTS, "min_condition": 20.0}, "min_condition must be left out where ports"),
    ],
)
def test_impossible_endoscopes_are_refused_in_one_sentence(choices: dict, words: str) -> None:
    with pytest.raises(BadInput, match=rf"scene\.{words}"):
        SceneSettings(**choices)
