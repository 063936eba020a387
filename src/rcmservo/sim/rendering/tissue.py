"""Tissue behind the tool: a rough, mottled, wet plane with veins, lit by the lamp."""

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
"""Distance, in units of the lamp's reach, at which the tissue begins to fade. It is black at twice
that distance."""

LIGHT_GUARD = 1e-12
"""Light that is added to a divisor, which may be zero."""


@dataclass(frozen=True, eq=False)
class Tissue(Checked):
    """Plane of the tissue, in the world.

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

    normal: Annotated[Floats, array(3), Limit(lambda x: bool(np.any(x)), "a direction")]

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


def render_tissue(
    slopes: Floats,
    optics: CameraModel,
    look: Appearance,
    tissue: Tissue,
    random: np.random.Generator,
) -> tuple[Light, Light]:
    """Return the tissue without the tool (H, W, 3), and the fraction (H, W) of it due to the lamp.

    A shadow removes that fraction. Both are zero where a ray meets no tissue.
    """
    position = tissue.intersect_rays(slopes, optics)
    mottle, veins, normal = _make_texture(position, tissue.normal_to_camera(optics), look, random)
    diffuse, specular = _reflect(position, normal, look)
    pale = 1 + look.contrast * mottle  # veins absorb blue and green light
    tint = np.stack([pale - look.contrast * veins] * 2 + [pale], axis=-1)
    colour = np.array(look.tissue_colour) * np.maximum(tint, 0)
    light = colour * (look.ambient + diffuse)[..., None] + 255 * specular[..., None]
    distance = np.linalg.norm(position, axis=-1)
    visibility = np.clip(2 - distance / (FADE_START_RATIO * look.reach), 0, 1)[..., None]
    lamp_fraction = (diffuse + specular) / (look.ambient + diffuse + specular + LIGHT_GUARD)
    lit, fraction = np.nan_to_num(visibility * light), np.nan_to_num(lamp_fraction)
    return lit.astype(np.float32), fraction.astype(np.float32)


def _reflect(position: Floats, normal: Floats, look: Appearance) -> tuple[Floats, Floats]:
    """Return the lamp's diffuse and specular light (H, W) from each `position`.

    Both `position` and the unit `normal` are (H, W, 3). The light is relative to the nominal colour
    (diffuse) and to grey level 255 (specular).
    """
    to_lamp, distance = _normalise(np.array(look.light) - position)
    half, _ = _normalise(to_lamp + _normalise(-position)[0])
    strength = 2 / (1 + (distance / look.reach) ** 2)
    diffuse = (1 - look.ambient) * np.maximum((normal * to_lamp).sum(axis=-1), 0) * strength
    glint = np.maximum((normal * half).sum(axis=-1), 0) ** look.exponent
    return diffuse, SPECULAR_RATIO * look.specular * glint * strength


def _make_texture(
    position: Floats, normal: Floats, look: Appearance, random: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return the texture at each `position` of a plane with this unit `normal` (3,).

    It fades where a pixel spans as much as a bump: finer detail than pixels would only cause
    aliasing.

    Returns
    -------
    mottle : Floats, shape (H, W)
        Brightness, of standard deviation 1.
    veins : Floats, shape (H, W)
        Strength of veins, from 0 to 2.
    rough_normal : Floats, shape (H, W, 3)
        Unit normal of the rough surface.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    nodes = np.moveaxis(FIELD_NODES / look.texture * (position @ across.T), -1, 0)
    fade = _compute_resolved_fraction(position, look)
    mottle = _make_smooth_field(random, 2 * BUMP_SIZE_FRACTION)
    bumps = _make_smooth_field(random, BUMP_SIZE_FRACTION)
    vessels = _make_smooth_field(random, 4 * BUMP_SIZE_FRACTION)
    pitch_mm = look.texture / FIELD_NODES
    rough_normal = normal
    for i in range(2):
        slope = sample_field(look.relief * np.gradient(bumps, pitch_mm, axis=i), nodes)
        rough_normal = rough_normal - fade[..., None] * slope[..., None] * across[i]
    veins = 2 * np.exp(-np.abs(vessels) / VEIN_WIDTH)
    faded_mottle, faded_veins = (fade * sample_field(field, nodes) for field in (mottle, veins))
    return faded_mottle, faded_veins, _normalise(rough_normal)[0]


def _compute_resolved_fraction(position: Floats, look: Appearance) -> Floats:
    """Return the fraction (H, W) of the texture's detail that a pixel can resolve."""
    pixel_steps = [np.linalg.norm(step, axis=-1) for step in np.gradient(position, axis=(0, 1))]
    quarter_bump_mm = BUMP_SIZE_FRACTION * look.texture / 4
    return 1 / (1 + (np.max(pixel_steps, axis=0) / quarter_bump_mm) ** 2)


def _normalise(vectors: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (..., 3) and the lengths (...) of vectors."""
    length = np.linalg.norm(vectors, axis=-1)
    return vectors / length[..., None], length


def _make_smooth_field(random: np.random.Generator, size: float) -> Floats:
    """Return a smooth random field (FIELD_NODES, FIELD_NODES).

    `size` is that of its features, as a fraction of the field's width.
    """
    return make_random_field(random, FIELD_NODES, lambda waves: (1 + (waves * size) ** 2) ** -2.5)
