"""Lighting by a round lamp: shading of the capsules, and the tool's soft shadow on the tissue.

The shadow is computed at nodes `SHADOW_STEP_PX` apart and interpolated linearly between them.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.rendering.capsules import (
    Capsule,
    Capsules,
    Vector,
    clip_fraction,
    distance_to_axis,
    dot,
    read_capsule,
    scale,
    subtract,
)
from rcmservo.sim.rendering.coverage import TILE_PX
from rcmservo.sim.rendering.look import Appearance, Light
from rcmservo.sim.rendering.tissue import Tissue

SHADOW_STEP_PX = 4
"""Distance (px) of the nodes at which the shadow is computed."""

CELLS_PER_TILE = TILE_PX // SHADOW_STEP_PX
"""Cells of the shadow's grid along a tile."""


class Lamp(NamedTuple):
    """Light of an `Appearance`, as kernels read it.

    Parameters
    ----------
    position : Vector
        Position in camera axes, mm.
    radius : float
        Radius, mm.
    reach : float
        Distance at which a surface has its nominal colour, mm.
    ambient : float
        Fraction of ambient light.
    exponent : float
        Exponent of specular highlights.
    """

    position: Vector

    radius: float

    reach: float

    ambient: float

    exponent: float


def build_lamp(look: Appearance) -> Lamp:
    """Return the lamp of an appearance."""
    x, y, z = map(float, look.light)
    return Lamp((x, y, z), *map(float, (look.lamp_radius, look.reach, look.ambient, look.exponent)))


@compiled
def shade(position: Vector, capsule: Capsule, lamp: Lamp) -> Vector:
    """Return the light (blue, green, red) from a `position` on a capsule.

    It is the sum of Lambert's diffuse light, ambient light and Blinn's highlight.
    """
    n, r, nn = capsule.n, capsule.radius, capsule.nn
    along = clip_fraction((dot(position, n) - capsule.An) / nn) if nn > 0.0 else 0.0
    outward = subtract(subtract(position, capsule.A), scale(along, n))  # of length r
    to_lamp = subtract(lamp.position, position)
    distance = np.sqrt(dot(to_lamp, to_lamp))
    strength = 2.0 / (1.0 + (distance / lamp.reach) ** 2)
    facing = max(dot(outward, to_lamp), 0.0) / (r * distance)
    from_camera = scale(1.0 / np.sqrt(dot(position, position)), position)
    half = subtract(scale(1.0 / distance, to_lamp), from_camera)
    mirror = dot(outward, half) / (r * np.sqrt(dot(half, half)))
    glint = 0.0
    if mirror > 0.0 and lamp.exponent * (mirror - 1.0) > -7.0:  # otherwise it is below 0.001
        glint = capsule.highlight * strength * mirror**lamp.exponent
    bright = lamp.ambient + (1.0 - lamp.ambient) * facing * strength
    blue, green, red = capsule.colour
    return blue * bright + glint, green * bright + glint, red * bright + glint


def build_shadow_nodes(optics: CameraModel, tissue: Tissue) -> Floats:
    """Return the tissue's points (rows, columns, 3) mm in camera axes at the shadow's nodes."""
    sides = optics.width, optics.height
    u, v = (np.arange(0, -(-size // TILE_PX) * TILE_PX + 1, SHADOW_STEP_PX) for size in sides)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float64)
    return tissue.intersect_rays(optics.slopes(pixels), optics)


@compiled
def cast_shadow(
    canvas: Light, lamp_fraction: Light, nodes: Floats, capsules: Capsules, lamp: Lamp
) -> None:
    """Remove the lamp's light that the capsules block from the tissue on the canvas (H, W, 3)."""
    n = CELLS_PER_TILE + 1
    blocked = np.empty((n, n))
    for i in range((nodes.shape[0] - 1) // CELLS_PER_TILE):
        for j in range((nodes.shape[1] - 1) // CELLS_PER_TILE):
            row, column = i * CELLS_PER_TILE, j * CELLS_PER_TILE
            patch = nodes[row : row + n, column : column + n]
            bits = find_casters(patch, capsules, lamp)
            if bits == 0:
                continue
            for v in range(n):
                for u in range(n):
                    node = read_node(patch, v, u)
                    blocked[v, u] = compute_blocked_fraction(node, capsules, bits, lamp)
            top, left = i * TILE_PX, j * TILE_PX
            tile = canvas[top : top + TILE_PX, left : left + TILE_PX]
            darken_tile(tile, lamp_fraction[top:, left:], blocked)


@compiled
def read_node(patch: Floats, v: int, u: int) -> Vector:
    """Return one point of a patch (n, n, 3) of tissue."""
    return patch[v, u, 0], patch[v, u, 1], patch[v, u, 2]


@compiled
def find_casters(patch: Floats, capsules: Capsules, lamp: Lamp) -> int:
    """Return the set of capsules, as bits, that may block part of the lamp from part of a patch."""
    centre, end = patch.shape[0] // 2, patch.shape[0] - 1
    middle, size = read_node(patch, centre, centre), 0.0
    for v in (0, end):
        for u in (0, end):
            across = subtract(read_node(patch, v, u), middle)
            size = max(size, np.sqrt(dot(across, across)))
    bits = 0
    to_lamp = subtract(lamp.position, middle)
    for k in range(4):
        capsule = read_capsule(capsules, 0, k)
        distance, _ = distance_to_axis(middle, to_lamp, capsule)
        if capsule.radius > 0.0 and distance < capsule.radius + size + lamp.radius:
            bits |= 1 << k
    return bits


@compiled
def compute_blocked_fraction(position: Vector, capsules: Capsules, bits: int, lamp: Lamp) -> float:
    """Return the fraction (0 to 1) of the round lamp that the capsules block at a `position`.

    The cone from the position to the lamp has a radius h at the capsule: half the width of the
    shadow's soft edge.
    """
    largest, to_lamp = 0.0, subtract(lamp.position, position)
    for k in range(4):
        if bits >> k & 1:
            capsule = read_capsule(capsules, 0, k)
            distance, fraction = distance_to_axis(position, to_lamp, capsule)
            h, r = lamp.radius * max(fraction, 1e-6), capsule.radius
            inside = clip_fraction((r + h - distance) / (2.0 * h))
            largest = max(largest, inside * inside * (3.0 - 2.0 * inside) * min(r / h, 1.0))
    return largest


@compiled
def darken_tile(tile: Light, lamp_fraction: Light, blocked: Floats) -> None:
    """Darken the pixels of a tile by the fractions of the lamp that are blocked at its nodes."""
    for y in range(tile.shape[0]):
        v, dv = y // SHADOW_STEP_PX, y % SHADOW_STEP_PX / SHADOW_STEP_PX
        for x in range(tile.shape[1]):
            u, du = x // SHADOW_STEP_PX, x % SHADOW_STEP_PX / SHADOW_STEP_PX
            above = blocked[v, u] + du * (blocked[v, u + 1] - blocked[v, u])
            below = blocked[v + 1, u] + du * (blocked[v + 1, u + 1] - blocked[v + 1, u])
            remaining = 1.0 - lamp_fraction[y, x] * (above + dv * (below - above))
            for c in range(3):
                tile[y, x, c] *= remaining
