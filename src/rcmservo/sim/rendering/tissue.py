"""The tissue behind the tool: a bumpy, mottled, wet plane, lit by the lamp."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import Checked, Limit, array
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering.look import Light, Look
from rcmservo.sim.rendering.random_fields import random_field, sampled

TEXELS = 512
"""Places across a random field."""

BUMP = 0.05
"""The size of a bump, as a share of the texture's period."""

VEIN = 0.08
"""The width of a vein, in the spread of the field that it is cut from."""

WETNESS = 0.3
"""How strongly tissue shines, as a share of the tool."""

HORIZON = 3.0
"""Times the lamp's reach: from here to twice as far the tissue fades into the dark."""

TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Tissue(Checked):
    """The plane behind the tool, in the world."""

    point: Annotated[Floats, array(3)]
    """(3,) mm, on the plane."""

    normal: Annotated[Floats, array(3), Limit(np.any, "a direction")]
    """(3,), either way up."""

    def met_by(self, slopes: Floats, optics: Optics) -> Floats:
        """Where rays of `slopes` (..., 2) meet the tissue, mm in camera axes (..., 3).

        NaN where they never do.
        """
        rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        normal = optics.rotation @ self.normal
        height = normal @ (optics.rotation @ (self.point - optics.position))
        with np.errstate(divide="ignore"):
            depth = height / (rays @ normal)
        return rays * np.where((depth > 0) & (depth < np.inf), depth, np.nan)[..., None]

    def facing(self, optics: Optics) -> Floats:
        """The unit normal (3,) in camera axes, on the camera's side."""
        normal = optics.rotation @ self.normal / np.linalg.norm(self.normal)
        return normal * np.sign(normal @ (optics.rotation @ (optics.position - self.point)))


@dataclass(frozen=True, eq=False)
class Texture:
    """The tissue's surface as the pixels see it."""

    mottle: Floats
    """(H, W): paler and darker places, of spread 1."""

    veins: Floats
    """(H, W): from 0 to 2."""

    normal: Floats
    """(H, W, 3): the bumpy surface's unit normal."""


def lit(
    slopes: Floats, optics: Optics, look: Look, tissue: Tissue, noise: np.random.Generator
) -> tuple[Light, Light]:
    """The tissue without the tool (H, W, 3), and the share (H, W) of it that the lamp gives.

    That share is what a shadow takes.
    """
    place = tissue.met_by(slopes, optics)
    texture = _texture(place, tissue.facing(optics), look, noise)
    lamp, wet = _reflected(place, texture.normal, look)
    colour = np.array(look.tissue_colour) * np.maximum(_tint(texture, look), 0)
    light = colour * (look.ambient + lamp)[..., None] + 255 * wet[..., None]
    away = np.linalg.norm(place, axis=-1)
    visible = np.clip(2 - away / (HORIZON * look.reach), 0, 1)[..., None]
    share = (lamp + wet) / (look.ambient + lamp + wet + TINY)
    return _known(visible * light), _known(share)


def _known(light: Floats) -> Light:
    """The light, dark where a ray meets no tissue."""
    return np.nan_to_num(light).astype(np.float32)


def _reflected(place: Floats, normal: Floats, look: Look) -> tuple[Floats, Floats]:
    """The lamp's light that each `place` scatters, and that which its wetness mirrors: (H, W)."""
    to_lamp, distance = _unit(np.array(look.light) - place)
    half, _ = _unit(to_lamp + _unit(-place)[0])
    strength = 2 / (1 + (distance / look.reach) ** 2)
    lamp = (1 - look.ambient) * np.maximum((normal * to_lamp).sum(axis=-1), 0) * strength
    mirrored = np.maximum((normal * half).sum(axis=-1), 0) ** look.exponent
    return lamp, WETNESS * look.specular * mirrored * strength


def _tint(texture: Texture, look: Look) -> Floats:
    """What the texture makes of the tissue's colour (H, W, 3): veins take blue and green."""
    pale = 1 + look.contrast * texture.mottle
    return np.stack([pale - look.contrast * texture.veins] * 2 + [pale], axis=-1)


def _texture(place: Floats, normal: Floats, look: Look, noise: np.random.Generator) -> Texture:
    """The texture at each `place` of the plane with this unit `normal` (3,).

    It fades where a pixel spans as much as a bump: finer detail than pixels would only make false
    patterns.
    """
    across = np.linalg.svd(normal[None])[2][1:]
    texels = np.moveaxis(TEXELS / look.texture * (place @ across.T), -1, 0)
    fade = _fade(place, look)
    mottle, bumps, vessels = (_field(noise, size) for size in (2 * BUMP, BUMP, 4 * BUMP))
    pitch = look.texture / TEXELS
    slopes = [look.relief * np.gradient(bumps, pitch, axis=i) for i in range(2)]
    tilts = [fade[..., None] * sampled(slopes[i], texels)[..., None] * across[i] for i in range(2)]
    veins = 2 * np.exp(-np.abs(vessels) / VEIN)
    return Texture(
        fade * sampled(mottle, texels),
        fade * sampled(veins, texels),
        _unit(normal - tilts[0] - tilts[1])[0],
    )


def _fade(place: Floats, look: Look) -> Floats:
    """How much of the texture's detail a pixel can show (H, W)."""
    changes = [np.linalg.norm(change, axis=-1) for change in np.gradient(place, axis=(0, 1))]
    return 1 / (1 + (np.max(changes, axis=0) / (BUMP * look.texture / 4)) ** 2)


def _unit(vectors: Floats) -> tuple[Floats, Floats]:
    """Vectors (..., 3) as directions, and their lengths (...)."""
    length = np.linalg.norm(vectors, axis=-1)
    return vectors / length[..., None], length


def _field(noise: np.random.Generator, size: float) -> Floats:
    """A smooth random field (TEXELS, TEXELS). `size` is that of its features, as a share of its
    width."""
    return random_field(noise, TEXELS, lambda waves: (1 + (waves * size) ** 2) ** -2.5)
