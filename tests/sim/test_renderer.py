"""Rendered images: coverage is integrated over pixel and exposure, the noise is as specified."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from conftest import make_environment
from rcmservo.errors import BadInput
from rcmservo.sim.camera_model import CameraModel, compute_look_at_rotation
from rcmservo.sim.rendering import Appearance, Renderer, Tissue

POSITION = np.array([-70.0, -60.0, 20.0])
TARGET = np.array([0.0, 0.0, -110.0])
TISSUE = Tissue(np.array([0.0, 0.0, -165.0]), np.array([0.0, 0.0, 1.0]))
OPTICS = CameraModel(
    320,
    240,
    350.0,
    np.array([161.0, 118.0]),
    np.array([-0.15, 0.03]),
    compute_look_at_rotation(POSITION, TARGET, 0.2),
    POSITION,
)
QUIET = Appearance(full_well=np.inf, read_noise=0.0)
FLAT = replace(
    QUIET, ambient=1.0, specular=0.0, contrast=0.0
)  # one colour each for tissue and bodies
BALLS = replace(
    FLAT,
    shaft_radius=0.0,
    jaw_radius=0.0,
    tissue_colour=(0.0, 0.0, 0.0),
    marker_colours=((0.0, 250.0, 0.0), (250.0, 0.0, 0.0)),
)
RENDERERS: dict[Appearance, Renderer] = {}


def tool(m1, along=(0.1, 0.1, -1.0), spacing=25.0):
    """Return the tool's points (4, 3) for m1 and the direction of the shaft."""
    n = np.array(along) / np.linalg.norm(along)
    return np.stack([m1, m1 + spacing * n, m1 - 90 * n, m1 + (spacing + 16) * n])


def rendered(look, *poses, number=0):
    return renderer_of(look).render(np.stack(poses), number)


def renderer_of(look):
    if look not in RENDERERS:
        RENDERERS[look] = Renderer(OPTICS, look, TISSUE, 0)
    return RENDERERS[look]


def in_view(rng):
    """Return a point (3,) mm that projects well inside the image."""
    pixel = rng.uniform([30, 30], [290, 210])
    slope = OPTICS.slopes(pixel)
    return POSITION + rng.uniform(80, 160) * np.array([*slope, 1.0]) @ OPTICS.rotation


def centroid(channel):
    weight = channel.astype(float)
    v, u = np.indices(channel.shape)
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


def test_an_imaged_ball_has_the_centroid_of_the_camera_model():
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(40):
        m1 = in_view(rng)
        hidden = np.stack([m1, 2 * POSITION - m1, m1, m1])
        found = centroid(rendered(BALLS, hidden)[..., 1])
        errors.append(found - OPTICS.silhouette_centre(m1, BALLS.marker_radii[0]))
    assert np.abs(errors).max() < 0.03
    assert np.sqrt(np.mean(np.square(errors))) < 0.01


def test_an_imaged_ball_has_the_area_of_the_camera_model():
    m1 = in_view(np.random.default_rng(2))
    area = rendered(BALLS, np.stack([m1, 2 * POSITION - m1, m1, m1]))[..., 1].sum() / 250
    assert np.sqrt(area / np.pi) == pytest.approx(OPTICS.silhouette_radius(m1, 3.5), abs=0.01)


@pytest.mark.parametrize("moments", [2, 4, 8, 16])
@pytest.mark.parametrize("blur", [0.2, 1.0, 4.0])
def test_exposure_blur_moves_the_centroid_to_the_mean_of_the_exposure(moments, blur):
    rng = np.random.default_rng(3)
    for _ in range(3):
        m1, step = in_view(rng), 1.5 * blur * rng.normal(size=3) / np.sqrt(3)
        path = m1 + step * np.linspace(-0.5, 0.5, moments)[:, None]
        poses = [np.stack([p, 2 * POSITION - p, p, p]) for p in path]
        found = centroid(rendered(BALLS, *poses)[..., 1])
        areas = [OPTICS.silhouette_radius(p, 3.5) ** 2 for p in path]
        expected = np.average(
            [OPTICS.silhouette_centre(p, 3.5) for p in path], axis=0, weights=areas
        )
        assert np.abs(found - expected).max() < 0.04


def test_the_same_seed_and_number_give_the_same_image_bit_for_bit():
    pose = tool(TARGET)
    again = Renderer(OPTICS, Appearance(), TISSUE, 0)
    again.render(tool(TARGET + 5)[None], 2)
    assert np.array_equal(rendered(Appearance(), pose, number=7), again.render(pose[None], 7))


def test_another_number_or_seed_gives_other_noise():
    pose = tool(TARGET)
    first = rendered(Appearance(), pose, number=7).astype(float)
    for other in (
        rendered(Appearance(), pose, number=8),
        Renderer(OPTICS, Appearance(), TISSUE, 1).render(pose[None], 7),
    ):
        assert (other != first).mean() > 0.5


def test_the_noise_has_the_variance_of_the_look():
    full_well, read_noise, light = 6000.0, 1.5, np.array([60.0, 130.0, 200.0])
    look = replace(FLAT, tissue_colour=tuple(light), full_well=full_well, read_noise=read_noise)
    noisy = (
        Renderer(OPTICS, look, TISSUE, 0)
        .render(tool(2 * POSITION - TARGET)[None], 0)
        .reshape(-1, 3)
    )
    expected = light * 255 / full_well + read_noise**2 + 1 / 12  # the last for rounding
    assert np.allclose(noisy.mean(axis=0), light, atol=0.02)
    assert np.allclose(noisy.var(axis=0), expected, rtol=0.02)


def test_light_beyond_the_range_is_clipped():
    look = replace(FLAT, tissue_colour=(0.0, 255.0, 300.0), read_noise=20.0)
    noisy = Renderer(OPTICS, look, TISSUE, 0).render(tool(2 * POSITION - TARGET)[None], 0)
    assert (noisy[..., 0] == 0).mean() > 0.4
    assert (noisy[..., 1] == 255).mean() > 0.4
    assert noisy[..., 2].min() > 150


def test_the_shaft_hides_part_of_a_ball():
    pose = tool(TARGET)
    colour = np.array(FLAT.marker_colours[0])
    look = replace(FLAT, marker_radii=(7.0, 7.0), shaft_radius=5.0, jaw_radius=2.4)
    bare = replace(look, shaft_radius=0.0, jaw_radius=0.0)

    def visible(image):
        return (np.abs(image - colour).max(axis=-1) < 1).sum()

    with_shaft, without = rendered(look, pose), rendered(bare, pose)
    assert 0.4 * visible(without) < visible(with_shaft) < 0.95 * visible(without)


def test_the_nearer_ball_hides_the_farther():
    m1 = OPTICS.position + 100 * OPTICS.rotation[2]
    image = rendered(BALLS, np.stack([m1, m1 + 20 * OPTICS.rotation[2], m1, m1]))
    assert image[..., 1].max() == 250
    assert image[..., 0].max() == 0


def test_the_tool_darkens_the_tissue_softly():
    bare = rendered(QUIET, tool(2 * POSITION - TARGET)).astype(float)
    shadowed = rendered(QUIET, tool(TARGET)).astype(float)
    body = np.abs(rendered(FLAT, tool(TARGET)) - np.array(FLAT.tissue_colour)).max(axis=-1) > 1
    ratio = (shadowed / np.maximum(bare, 1)).mean(axis=-1)[~body & (bare.min(axis=-1) > 20)]
    assert (ratio < 0.5).sum() > 125
    assert ((ratio > 0.5) & (ratio < 0.95)).sum() > 125
    assert (ratio > 1.05).sum() == 0


def test_uniform_light_casts_no_shadow():
    image = rendered(FLAT, tool(2 * POSITION - TARGET))
    assert np.unique(image.reshape(-1, 3), axis=0).tolist() == [list(FLAT.tissue_colour)]


def test_only_tiles_that_the_tool_touches_change_when_it_moves():
    first, second = rendered(FLAT, tool(TARGET)), rendered(FLAT, tool(TARGET + 0.1))
    assert 0 < (first != second).any(axis=-1).mean() < 0.05


@pytest.mark.parametrize(
    "m1",
    [
        2 * POSITION - TARGET,  # behind the camera
        TARGET + 500.0,  # at its side
        POSITION,  # around it
        POSITION + 3.6 * OPTICS.rotation[2],  # touching it
        TARGET - [0, 0, 60.0],  # in the tissue
    ],
)
@pytest.mark.parametrize(
    "along", [OPTICS.rotation[2], OPTICS.rotation[0], -OPTICS.rotation[2], np.ones(3)]
)
def test_every_position_of_the_tool_gives_an_image(m1, along):
    image = rendered(QUIET, tool(m1, along), tool(m1 + 0.3, along))
    assert image.shape == (240, 320, 3)
    assert image.mean() > 2


def test_a_shaft_that_starts_behind_the_camera_enters_from_the_border():
    tip = POSITION + 120 * OPTICS.rotation[2]
    start = POSITION - 60 * OPTICS.rotation[2] + 30 * OPTICS.rotation[0]
    n = (tip - start) / np.linalg.norm(tip - start)
    image = rendered(FLAT, np.stack([tip - 30 * n, tip - 15 * n, start, tip]))
    shaft = np.abs(image - np.array(FLAT.shaft_colour)).max(axis=-1) < 1
    assert shaft[:, -1].any()
    assert shaft.sum() > 500
    assert not shaft[:, 0].any()


def test_tiles_do_not_change_the_visible_body():
    """Compare with one ray per pixel, one body at a time, without tiles."""
    rng = np.random.default_rng(5)
    rays = OPTICS.rays()
    for _ in range(5):
        m1 = in_view(rng)
        image = rendered(BALLS, np.stack([m1, 2 * POSITION - m1, m1, m1]))[..., 1]
        miss = np.linalg.norm(np.cross(rays, m1 - POSITION), axis=-1)
        assert (image[miss < 3.5 - 0.3] == 250).all()
        assert (image[miss > 3.5 + 0.3] == 0).all()


def test_an_image_may_have_partial_tiles():
    optics = replace(OPTICS, width=101, height=67, focal=110.0, centre=np.array([50.0, 33.0]))
    image = Renderer(optics, QUIET, TISSUE, 0).render(tool(TARGET)[None], 0)
    assert image.shape == (67, 101, 3)
    assert len(np.unique(image[..., 0])) > 10


def small_image():
    optics = replace(OPTICS, width=44, height=30, focal=60.0, centre=np.array([21.0, 15.0]))
    poses = np.stack([tool(TARGET + 0.2 * step) for step in range(4)])
    return Renderer(
        optics, replace(Appearance(), marker_radii=(12.0, 12.0), shaft_radius=8.0), TISSUE, 0
    ).render(poses, 0)


def test_compiled_and_plain_python_render_the_same_image(tmp_path):
    program = (
        f"import numpy, test_renderer as t; numpy.save({str(tmp_path / 'plain.npy')!r}, "
        f"t.small_image())"
    )
    plainly = make_environment(NUMBA_DISABLE_JIT="1")
    subprocess.run([sys.executable, "-c", program], env=plainly, check=True, timeout=120)
    difference = small_image().astype(int) - np.load(tmp_path / "plain.npy")
    assert np.abs(difference).max() <= 1
    assert (difference != 0).mean() < 0.01


@pytest.mark.parametrize(
    "poses",
    [np.zeros((4, 3)), np.zeros((3, 4, 3)), np.zeros((0, 4, 3)), np.full((1, 4, 3), np.nan)],
)
def test_impossible_poses_are_refused(poses):
    with pytest.raises(BadInput):
        renderer_of(QUIET).render(poses, 0)


@pytest.mark.parametrize(
    "change",
    [
        {"ambient": 1.2},
        {"shaft_radius": -1.0},
        {"marker_radii": (3.0, np.nan)},
        {"full_well": 0.0},
        {"light": (0.0, np.nan, 0.0)},
        {"light": (0, np.nan, 0)},
    ],
)
def test_an_impossible_look_is_refused(change):
    with pytest.raises(BadInput, match=next(iter(change))):
        Appearance(**change)
