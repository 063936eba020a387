"""Tissue behind the tool: a rough, mottled, wet plane, lit by the lamp."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, Limit, array
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.rendering.look import Appearance, Light
from rcmservo.sim.rendering.random_fields import make_random_field, sample_field

FIELD_NODES = 512
"""Nodes along a side of a random field."""

BUMP_SIZE_FRACTION = 0.05
"""Size of a bump, as a fraction of the texture's period."""

VEIN_WIDTH = 0.08
"""Width of a vein, in standard deviations of the field from which it is cut."""

SPECULAR_RATIO = 0.3
"""Ratio of the tissue's specular intensity to the tool's."""

FADE_START_RATIO = 3.0
"""Distance, in units of the lamp's reach, from which to twice as far the tissue fades to black."""

LIGHT_GUARD = 1e-12
"""Guard against division by zero light."""


@dataclass(frozen=True, eq=False)
class Tissue(Checked):
    """Plane behind the tool, in the world.

    Parameters
    ----------
    point : Floats
        Point (3,) of the plane, mm.
    normal : Floats
        Normal (3,) of the plane, of any length and sign.

    Raises
    ------
    BadInput
        If a field has another shape, or the normal is zero.
    """

    point: Annotated[Floats, array(3)]

    normal: Annotated[Floats, array(3), Limit(np.any, "a direction")]

    def intersect_rays(self, slopes: Floats, optics: CameraModel) -> Floats:
        """Return the points (..., 3) at which rays of `slopes` (..., 2) meet the plane.

        They are in camera axes, mm, and NaN where a ray misses the plane.
        """
        rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        normal = optics.rotation @ self.normal
        height = normal @ (optics.rotation @ (self.point - optics.position))
        with np.errstate(divide="ignore"):
            depth = height / (rays @ normal)
        return rays * np.where((depth > 0) & (depth < np.inf), depth, np.nan)[..., None]

    def normal_to_camera(self, optics: CameraModel) -> Floats:
        """Return the unit normal (3,) in camera axes on the camera's side."""
        normal = optics.rotation @ self.normal / np.linalg.norm(self.normal)
        return normal * np.sign(normal @ (optics.rotation @ (optics.position - self.point)))


@dataclass(frozen=True, eq=False)
class Texture:
    """Surface of the tissue at each pixel.

    Parameters
    ----------
    mottle : Floats
        Brightness (H, W) of standard deviation 1.
    veins : Floats
        Strength (H, W) of veins, from 0 to 2.
    normal : Floats
        Unit normal (H, W, 3) of the rough surface.
    """

    mottle: Floats

    veins: Floats

    normal: Floats


def render_tissue(
    slopes: Floats,
    optics: CameraModel,
    look: Appearance,
    tissue: Tissue,
    noise: np.random.Generator,
) -> tuple[Light, Light]:
    """Return the tissue without the tool (H, W, 3), and the fraction (H, W) of it due to the lamp.

    A shadow removes that fraction.
    """
    position = tissue.intersect_rays(slopes, optics)
    texture = _make_texture(position, tissue.normal_to_camera(optics), look, noise)
    lamp, wet = _reflect(position, texture.normal, look)
    colour = np.array(look.tissue_colour) * np.maximum(_tint(texture, look), 0)
    light = colour * (look.ambient + lamp)[..., None] + 255 * wet[..., None]
    distance = np.linalg.norm(position, axis=-1)
    visible = np.clip(2 - distance / (FADE_START_RATIO * look.reach), 0, 1)[..., None]
    fraction = (lamp + wet) / (look.ambient + lamp + wet + LIGHT_GUARD)
    return _zero_where_missed(visible * light), _zero_where_missed(fraction)


def _zero_where_missed(light: Floats) -> Light:
    """Return the light, zero where a ray meets no tissue."""
    return np.nan_to_num(light).astype(np.float32)


def _reflect(position: Floats, normal: Floats, look: Appearance) -> tuple[Floats, Floats]:
    """Return the lamp's diffuse and specular light (H, W) from each `position`."""
    to_lamp, distance = _normalise(np.array(look.light) - position)
    half, _ = _normalise(to_lamp + _normalise(-position)[0])
    strength = 2 / (1 + (distance / look.reach) ** 2)
    lamp = (1 - look.ambient) * np.maximum((normal * to_lamp).sum(axis=-1), 0) * strength
    mirrored = np.maximum((normal * half).sum(axis=-1), 0) ** look.exponent
    return lamp, SPECULAR_RATIO * look.specular * mirrored * strength


def _tint(texture: Texture, look: Appearance) -> Floats:
    """Return the factor (H, W, 3) of the tissue's colour: veins absorb blue and green."""
    pale = 1 + look.contrast * texture.mottle
    return np.stack([pale - look.contrast * texture.veins] * 2 + [pale], axis=-1)


def _make_texture(
    position: Floats, normal: Floats, look: Appearance, noise: np.random.Generator
) -> Texture:
    """Return the texture at each `position` of the plane with this unit `normal` (3,).

    It fades where a pixel spans as much as a bump: finer detail than pixels would only cause
    aliasing.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    texels = np.moveaxis(FIELD_NODES / look.texture * (position @ across.T), -1, 0)
    fade = _resolved_fraction(position, look)
    mottle, bumps, vessels = (
        _make_smooth_field(noise, size)
        for size in (2 * BUMP_SIZE_FRACTION, BUMP_SIZE_FRACTION, 4 * BUMP_SIZE_FRACTION)
    )
    pitch = look.texture / FIELD_NODES
    slopes = [look.relief * np.gradient(bumps, pitch, axis=i) for i in range(2)]
    tilts = [
        fade[..., None] * sample_field(slopes[i], texels)[..., None] * across[i] for i in range(2)
    ]
    veins = 2 * np.exp(-np.abs(vessels) / VEIN_WIDTH)
    return Texture(
        fade * sample_field(mottle, texels),
        fade * sample_field(veins, texels),
        _normalise(normal - tilts[0] - tilts[1])[0],
    )


def _resolved_fraction(position: Floats, look: Appearance) -> Floats:
    """Return the fraction (H, W) of the texture's detail that a pixel can resolve."""
    steps = [np.linalg.norm(change, axis=-1) for change in np.gradient(position, axis=(0, 1))]
    return 1 / (1 + (np.max(steps, axis=0) / (BUMP_SIZE_FRACTION * look.texture / 4)) ** 2)


def _normalise(vectors: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (..., 3) and the lengths (...) of vectors."""
    length = np.linalg.norm(vectors, axis=-1)
    return vectors / length[..., None], length


def _make_smooth_field(noise: np.random.Generator, size: float) -> Floats:
    """Return a smooth random field (FIELD_NODES, FIELD_NODES).

    `size` is that of its features, as a fraction of its width.
    """
    return make_random_field(noise, FIELD_NODES, lambda waves: (1 + (waves * size) ** 2) ** -2.5)
