"""Model of one pixel at the edge of a shaded ball.

A point of the ball with the normal (x, y, z) has the level

    ambient + max(0, l1 x + l2 y + l3 z)

by Lambert's law: beyond the terminator, where no light arrives, only the ambient light remains.
Near the edge z changes fast; a model without z puts the lit side too far in. A lamp next to a near
camera leaves a crescent of the edge unlit; a model without the terminator shifts the ball.

The unknowns x are (u, v, r, e1, e2, ambient, l1, l2, l3).
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

UNKNOWN_COUNT = 9


@compiled
def evaluate_pixel(pixel: Floats, x: Floats, terms: Floats) -> None:
    """Fill `terms` (8,) with the residual of one pixel and its derivatives.

    `pixel` (6,) is a row of `edge_fit.collect_edge_pixels`. The terms are: the residual; its slope,
    the increase of the level if the outline moves out by one pixel; cosine and sine of the
    direction from the centre; the covered fraction of the pixel; the normal's x, y and z, where z
    is integrated over that fraction. The normal is 0 beyond the terminator.
    """
    dx, dy = pixel[0] - x[0], pixel[1] - x[1]
    rho = np.sqrt(dx * dx + dy * dy)
    c, s = dx / rho, dy / rho
    radius = x[2] + x[3] * (c * c - s * s) + x[4] * 2.0 * c * s
    depth = radius - rho
    terms[:] = 0.0
    terms[0] = pixel[2] - pixel[5]
    if depth <= -0.71:
        return
    coverage, slope = compute_covered_area(depth, abs(c), abs(s))
    inner, z_inner = integrate_normal_z(depth + 0.5, radius)
    outer, z_outer = integrate_normal_z(depth - 0.5, radius)
    terms[2], terms[3], terms[4] = c, s, coverage
    terms[5], terms[6], terms[7] = dx / radius, dy / radius, inner - outer
    lit = x[6] * terms[5] + x[7] * terms[6]
    if lit + x[8] * np.sqrt(2.0 * max(depth, 0.0) / radius) < 0.0:
        terms[5:] = 0.0
        lit = 0.0
    flat = x[5] + lit - pixel[5]
    terms[0] -= coverage * flat + x[8] * terms[7]
    if slope > 0.0:
        terms[1] = slope * flat + (x[8] * (z_inner - z_outer) if terms[7] > 0.0 else 0.0)


@compiled
def compute_covered_area(depth: float, c: float, s: float) -> tuple[float, float]:
    """Return the fraction of a square pixel inside a straight edge, and its derivative by `depth`.

    The pixel's centre is `depth` px inside. The edge's normal has the direction cosines c and s,
    neither negative.
    """
    long, short, offset = max(c, s), min(c, s), abs(depth)
    if offset <= 0.5 * (long - short):
        return 0.5 + depth / long, 1.0 / long
    rest = 0.5 * (long + short) - offset
    if rest <= 0.0:
        return (1.0 if depth > 0.0 else 0.0), 0.0
    corner = 0.5 * rest * rest / (long * short)
    return (1.0 - corner if depth > 0.0 else corner), rest / (long * short)


@compiled
def integrate_normal_z(depth: float, radius: float) -> tuple[float, float]:
    """Return the integral of the normal's z from the edge to `depth`, and z at `depth`."""
    if depth <= 0.0:
        return 0.0, 0.0
    z = np.sqrt(2.0 * depth / radius)
    ratio = depth / radius
    return depth * z * (2.0 / 3.0 - 0.1 * ratio), z * (1.0 - 0.25 * ratio)
