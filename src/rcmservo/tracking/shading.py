"""Model of one pixel at the edge of a shaded ball.

A point of the ball with the unit normal n = (nx, ny, nz), z towards the camera, has the level

    ball = ambient + max(0, l1 nx + l2 ny + l3 nz)

by Lambert's law: beyond the terminator, where no directional light arrives, only the ambient light
remains. A pixel on the outline has the level

    background + covered fraction x (ball - background)

Near the edge nz changes fast, so the model integrates it over the covered part of the pixel; a
model without nz puts the lit side too far in. A lamp next to a near camera leaves a crescent of the
edge unlit; a model without the terminator shifts the ball.

The unknowns x are (u, v, r, e1, e2, ambient, l1, l2, l3): centre (u, v) and mean radius r of the
outline, px; its elongation (e1, e2), px, as in circle_fit.py; and, in grey levels, the ambient
light and the vector (l1, l2, l3) of the directional light.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled

UNKNOWN_COUNT = 9
"""Number of unknowns of the model."""

HALF_DIAGONAL_PX = 0.71
"""Half the diagonal of a pixel, rounded up: a pixel farther outside the outline is not covered."""


@compiled
def evaluate_pixel(pixel: Floats, x: Floats, terms: Floats) -> None:
    """Fill `terms` with the residual of one pixel and the factors of its derivatives.

    Parameters
    ----------
    pixel : array (6,)
        Row of `edge_fit.collect_edge_pixels`: column and row (px), level, trust, fractional ray
        number, and level of the background. Trust and ray are not used.
    x : array (9,)
        Unknowns of the module.
    terms : array (8,)
        Output: the residual, which is the measured minus the modelled level; the slope, which is
        the increase of the modelled level per px that the outline moves out; cosine and sine of the
        direction from the centre to the pixel; the covered fraction; nx, ny, and the integral of nz
        over the covered fraction. The last three are 0 beyond the terminator.
    """
    u, v, r, e1, e2, ambient, l1, l2, l3 = x
    level, background = pixel[2], pixel[5]
    dx, dy = pixel[0] - u, pixel[1] - v
    distance = np.sqrt(dx * dx + dy * dy)
    cosine, sine = dx / distance, dy / distance
    radius = r + e1 * (cosine * cosine - sine * sine) + e2 * 2.0 * cosine * sine
    depth = radius - distance
    terms[:] = 0.0
    terms[0] = level - background
    if depth <= -HALF_DIAGONAL_PX:
        return
    coverage, coverage_slope = compute_coverage(depth, abs(cosine), abs(sine))
    integral_inside, nz_inside = integrate_normal_z(depth + 0.5, radius)
    integral_outside, nz_outside = integrate_normal_z(depth - 0.5, radius)
    terms[2], terms[3], terms[4] = cosine, sine, coverage
    terms[5], terms[6], terms[7] = dx / radius, dy / radius, integral_inside - integral_outside
    diffuse_level = l1 * terms[5] + l2 * terms[6]
    if diffuse_level + l3 * np.sqrt(2.0 * max(depth, 0.0) / radius) < 0.0:
        terms[5:] = 0.0
        diffuse_level = 0.0
    contrast_without_z = ambient + diffuse_level - background
    terms[0] -= coverage * contrast_without_z + l3 * terms[7]
    if coverage_slope > 0.0:
        slope_of_z = l3 * (nz_inside - nz_outside) if terms[7] > 0.0 else 0.0
        terms[1] = coverage_slope * contrast_without_z + slope_of_z


@compiled
def compute_coverage(depth: float, abs_cos: float, abs_sin: float) -> tuple[float, float]:
    """Return the fraction of a square pixel inside a straight edge, and its derivative.

    Parameters
    ----------
    depth : float
        Distance of the pixel's centre from the edge, px, positive inside.
    abs_cos, abs_sin : float
        Absolute cosine and sine of the direction of the edge's normal.

    Returns
    -------
    tuple of float
        Covered fraction, 0 to 1, and its derivative with respect to `depth`, 1/px.
    """
    larger_cosine, smaller_cosine = max(abs_cos, abs_sin), min(abs_cos, abs_sin)
    offset = abs(depth)
    if offset <= 0.5 * (larger_cosine - smaller_cosine):
        return 0.5 + depth / larger_cosine, 1.0 / larger_cosine
    corner_depth = 0.5 * (larger_cosine + smaller_cosine) - offset
    if corner_depth <= 0.0:
        return (1.0 if depth > 0.0 else 0.0), 0.0
    corner_area = 0.5 * corner_depth * corner_depth / (larger_cosine * smaller_cosine)
    coverage = 1.0 - corner_area if depth > 0.0 else corner_area
    return coverage, corner_depth / (larger_cosine * smaller_cosine)


@compiled
def integrate_normal_z(depth: float, radius: float) -> tuple[float, float]:
    """Return the integral of nz over the depth, from the edge to `depth`, and nz at `depth`.

    Both are series in depth/radius, to the second term: nz = √(2 t) (1 - t/4 - ...) with
    t = depth/radius.

    Parameters
    ----------
    depth : float
        Distance inside the edge, px; outside, both results are 0.
    radius : float
        Radius of the ball in this direction, px.

    Returns
    -------
    tuple of float
        Integral in px, and nz.
    """
    if depth <= 0.0:
        return 0.0, 0.0
    z = np.sqrt(2.0 * depth / radius)
    ratio = depth / radius
    return depth * z * (2.0 / 3.0 - 0.1 * ratio), z * (1.0 - 0.25 * ratio)
