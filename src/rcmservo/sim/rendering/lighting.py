"""The tool's soft shadow on the tissue: exact at nodes STEP px apart, linear between them."""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering.capsules import (
    Capsule,
    Capsules,
    Vector,
    capsule_in,
    clip,
    dot,
    gap,
    minus,
    times,
)
from rcmservo.sim.rendering.coverage import TILE
from rcmservo.sim.rendering.look import Light, Look
from rcmservo.sim.rendering.tissue import Tissue

STEP = 4
"""px between the nodes at which the shadow is worked out."""

CELLS = TILE // STEP
"""Steps along a tile."""


class Lamp(NamedTuple):
    """The light of a Look, as the kernels take it."""

    place: Vector
    """mm."""

    radius: float
    """mm."""

    reach: float
    """mm."""

    ambient: float
    """The share of light that comes from everywhere."""

    exponent: float
    """The sharpness of highlights."""


def lamp_of(look: Look) -> Lamp:
    """The lamp of a look."""
    x, y, z = (float(value) for value in look.light)
    rest = look.lamp_radius, look.reach, look.ambient, look.exponent
    return Lamp((x, y, z), *(float(value) for value in rest))


@compiled
def shade(place: Vector, capsule: Capsule, lamp: Lamp) -> Vector:
    """The light from a `place` on a capsule: Lambert's, the ambient share, Blinn's highlight."""
    n, r, nn = capsule.n, capsule.radius, capsule.nn
    along = clip((dot(place, n) - capsule.An) / nn) if nn > 0.0 else 0.0
    outward = minus(minus(place, capsule.A), times(along, n))  # of length r
    to_lamp = minus(lamp.place, place)
    distance = np.sqrt(dot(to_lamp, to_lamp))
    strength = 2.0 / (1.0 + (distance / lamp.reach) ** 2)
    facing = max(dot(outward, to_lamp), 0.0) / (r * distance)
    half = minus(times(1.0 / distance, to_lamp), times(1.0 / np.sqrt(dot(place, place)), place))
    mirror = dot(outward, half) / (r * np.sqrt(dot(half, half)))
    glint = 0.0
    if mirror > 0.0 and lamp.exponent * (mirror - 1.0) > -7.0:  # beyond, it is below a thousandth
        glint = capsule.highlight * strength * mirror**lamp.exponent
    bright = lamp.ambient + (1.0 - lamp.ambient) * facing * strength
    blue, green, red = capsule.colour
    return blue * bright + glint, green * bright + glint, red * bright + glint


def nodes_of(optics: Optics, tissue: Tissue) -> Floats:
    """The tissue at every STEP-th pixel over all tiles, their far edges included, mm in camera
    axes."""
    sides = optics.width, optics.height
    u, v = (np.arange(0, -(-size // TILE) * TILE + 1, STEP) for size in sides)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float64)
    return tissue.met_by(optics.slopes(pixels), optics)


@compiled
def cast_shadow(
    canvas: Light, lamp_share: Light, nodes: Floats, capsules: Capsules, lamp: Lamp
) -> None:
    """Take from the tissue on the canvas the lamp's light that the capsules hide."""
    blocked = np.empty((CELLS + 1, CELLS + 1))
    for i in range((nodes.shape[0] - 1) // CELLS):
        for j in range((nodes.shape[1] - 1) // CELLS):
            patch = nodes[i * CELLS : (i + 1) * CELLS + 1, j * CELLS : (j + 1) * CELLS + 1]
            which = casters(patch, capsules, lamp)
            if which == 0:
                continue
            for v in range(CELLS + 1):
                for u in range(CELLS + 1):
                    blocked[v, u] = eclipse(node(patch, v, u), capsules, which, lamp)
            top, left = i * TILE, j * TILE
            darken(canvas[top : top + TILE, left : left + TILE], lamp_share[top:, left:], blocked)


@compiled
def node(patch: Floats, v: int, u: int) -> Vector:
    """One place of a patch (n, n, 3) of tissue."""
    return patch[v, u, 0], patch[v, u, 1], patch[v, u, 2]


@compiled
def casters(patch: Floats, capsules: Capsules, lamp: Lamp) -> int:
    """The set of capsules, as bits, that may hide part of the lamp from part of a patch."""
    centre, end = patch.shape[0] // 2, patch.shape[0] - 1
    middle, size = node(patch, centre, centre), 0.0
    for v in (0, end):
        for u in (0, end):
            across = minus(node(patch, v, u), middle)
            size = max(size, np.sqrt(dot(across, across)))
    which = 0
    for k in range(4):
        radius = capsule_in(capsules, 0, k).radius
        distance, _ = gap(middle, minus(lamp.place, middle), capsule_in(capsules, 0, k))
        if radius > 0.0 and distance < radius + size + lamp.radius:
            which |= 1 << k
    return which


@compiled
def eclipse(place: Vector, capsules: Capsules, which: int, lamp: Lamp) -> float:
    """How much of the round lamp the capsules hide from a place on the tissue, 0 to 1.

    The cone from the place to the lamp has a radius h at the capsule: half the width of the
    shadow's soft edge.
    """
    most = 0.0
    for k in range(4):
        if which >> k & 1:
            distance, on = gap(place, minus(lamp.place, place), capsule_in(capsules, 0, k))
            h, r = lamp.radius * max(on, 1e-6), capsule_in(capsules, 0, k).radius
            inside = clip((r + h - distance) / (2.0 * h))
            most = max(most, inside * inside * (3.0 - 2.0 * inside) * min(r / h, 1.0))
    return most


@compiled
def darken(tile: Light, lamp_share: Light, blocked: Floats) -> None:
    """Dim one tile by the lamp's light that its nodes miss."""
    for y in range(tile.shape[0]):
        v, dv = y // STEP, y % STEP / STEP
        for x in range(tile.shape[1]):
            u, du = x // STEP, x % STEP / STEP
            above = blocked[v, u] + du * (blocked[v, u + 1] - blocked[v, u])
            below = blocked[v + 1, u] + du * (blocked[v + 1, u + 1] - blocked[v + 1, u])
            keep = 1.0 - lamp_share[y, x] * (above + dv * (below - above))
            for c in range(3):
                tile[y, x, c] *= keep
