"""The lamp, and the light that it gives a place on a capsule."""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.sim.rendering.capsules import Capsule
from rcmservo.sim.rendering.look import Look
from rcmservo.sim.rendering.vectors import Vector, clip, dot, minus, times


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
