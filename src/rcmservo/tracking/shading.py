"""What a shaded ball shows in one pixel at its rim.

A place of the ball with the normal (x, y, z) shows the level

    ambient + max(0, l1 x + l2 y + l3 z)

by Lambert's law: beyond the terminator, where the lamp does not reach, only the ambient light is
left. Near the rim z changes fast, and a fit without it finds the lit side too far in. A lamp beside
a near camera leaves a crescent of the rim unlit, and a fit without the terminator shifts the ball.

The unknowns x are (u, v, r, e1, e2, ambient, l1, l2, l3).
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats

UNKNOWNS = 9


@compiled
def explain(pixel: Floats, x: Floats, spot: Floats) -> None:
    """Fill a row of the spots (8,) for a row of the pixels (6,).

    What x leaves of the pixel; its slope, by which it would show more if the outline moved out by a
    pixel; cosine and sine of its direction; the share that is covered; the normal's x, y and z, the
    last integrated over that share. The normal is 0 where the lamp does not reach.
    """
    dx, dy = pixel[0] - x[0], pixel[1] - x[1]
    rho = np.sqrt(dx * dx + dy * dy)
    c, s = dx / rho, dy / rho
    radius = x[2] + x[3] * (c * c - s * s) + x[4] * 2.0 * c * s
    depth = radius - rho
    spot[:] = 0.0
    spot[0] = pixel[2] - pixel[5]
    if depth <= -0.71:
        return
    share, rise = covered(depth, abs(c), abs(s))
    inner, z_inner = glow(depth + 0.5, radius)
    outer, z_outer = glow(depth - 0.5, radius)
    spot[2], spot[3], spot[4] = c, s, share
    spot[5], spot[6], spot[7] = dx / radius, dy / radius, inner - outer
    lit = x[6] * spot[5] + x[7] * spot[6]
    if lit + x[8] * np.sqrt(2.0 * max(depth, 0.0) / radius) < 0.0:
        spot[5:] = 0.0
        lit = 0.0
    flat = x[5] + lit - pixel[5]
    spot[0] -= share * flat + x[8] * spot[7]
    if rise > 0.0:
        spot[1] = rise * flat + (x[8] * (z_inner - z_outer) if spot[7] > 0.0 else 0.0)


@compiled
def covered(depth: float, c: float, s: float) -> tuple[float, float]:
    """How much of a square pixel lies within a straight edge, and how fast that rises.

    The pixel's centre is `depth` px inside; the edge's normal has the direction cosines c and s,
    neither negative.
    """
    long, short, out = max(c, s), min(c, s), abs(depth)
    if out <= 0.5 * (long - short):
        return 0.5 + depth / long, 1.0 / long
    rest = 0.5 * (long + short) - out
    if rest <= 0.0:
        return (1.0 if depth > 0.0 else 0.0), 0.0
    corner = 0.5 * rest * rest / (long * short)
    return (1.0 - corner if depth > 0.0 else corner), rest / (long * short)


@compiled
def glow(depth: float, radius: float) -> tuple[float, float]:
    """The integral from the rim to a depth within of the normal's z, and z there."""
    if depth <= 0.0:
        return 0.0, 0.0
    z = np.sqrt(2.0 * depth / radius)
    part = depth / radius
    return depth * z * (2.0 / 3.0 - 0.1 * part), z * (1.0 - 0.25 * part)
