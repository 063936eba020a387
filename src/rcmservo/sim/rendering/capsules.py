"""Tool as four capsules: shaft, jaw, and the balls 1 and 2, which are capsules of length 0.

A capsule is a cylinder with round ends: all points within a radius of a straight axis. `Capsules`
is an array (1 + T, 4, 15): first the mean pose of an exposure, then its T poses. A row of it holds
the numbers of one `Capsule`.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.rendering.look import Appearance

NEAR_PLANE_MM = 1.0
"""Depth (mm) of the near plane. The axis of a capsule is cut off where the capsule touches it."""

Capsules = Floats

Vector = tuple[float, float, float]


class Capsule(NamedTuple):
    """Capsule in one pose, with the products that every ray needs.

    Parameters
    ----------
    A : Vector
        One end A of the axis, mm.
    n : Vector
        Vector from A to the other end B, mm.
    radius : float
        Radius, mm; 0 if the capsule is absent or entirely behind the camera.
    nn : float
        n·n, mm².
    An : float
        A·n, mm².
    AA : float
        A·A − radius², mm².
    BB : float
        B·B − radius², mm².
    colour : Vector
        Colour (blue, green, red), grey levels.
    highlight : float
        Specular intensity, grey levels.
    """

    A: Vector

    n: Vector

    radius: float

    nn: float

    An: float

    AA: float

    BB: float

    colour: Vector

    highlight: float


def build_capsules(poses: Floats, optics: CameraModel, look: Appearance) -> Capsules:
    """Return the capsules (1 + T, 4, 15) of the tool in `poses` (T, 4, 3), as of `Renderer.render`.

    The shaft extends half-way from m2 to the tip, the thinner jaw from there on.
    """
    poses = np.concatenate([poses.mean(axis=0)[None], poses])
    m1, m2, start, tip = np.moveaxis((poses - optics.position) @ optics.rotation.T, 1, 0)
    wrist = (m2 + tip) / 2
    A = np.stack([start, wrist, m1, m2], axis=1)
    B = np.stack([wrist, tip, m1, m2], axis=1)
    radius = np.broadcast_to([look.shaft_radius, look.jaw_radius, *look.marker_radii], A.shape[:2])
    near = radius + NEAR_PLANE_MM
    A, B = _clip_to_near_plane(A, B, near), _clip_to_near_plane(B, A, near)
    r = np.where((A[..., 2] > radius) & (B[..., 2] > radius), radius, 0.0)
    n = B - A
    products = [(n * n).sum(-1), (A * n).sum(-1), (A * A).sum(-1) - r**2, (B * B).sum(-1) - r**2]
    colours = np.broadcast_to([look.shaft_colour, look.jaw_colour, *look.marker_colours], A.shape)
    highlight = np.full_like(r, 255 * look.specular)
    numbers = np.stack([r, *products], axis=-1)
    return np.concatenate([A, n, numbers, colours, highlight[..., None]], axis=-1)


def _clip_to_near_plane(end: Floats, other: Floats, near: Floats) -> Floats:
    """Move `end` along the axis to depth `near` if it is nearer than that and `other` is not."""
    depth, other_depth = end[..., 2], other[..., 2]
    is_cut = (depth < near) & (other_depth > near)
    fraction = np.where(is_cut, (near - depth) / np.where(is_cut, other_depth - depth, 1), 0.0)
    return end + fraction[..., None] * (other - end)


@compiled
def read_capsule(capsules: Capsules, pose: int, k: int) -> Capsule:
    """Return capsule `k` in a pose."""
    row = capsules[pose, k]
    A, n, colour = (row[0], row[1], row[2]), (row[3], row[4], row[5]), (row[11], row[12], row[13])
    return Capsule(A, n, row[6], row[7], row[8], row[9], row[10], colour, row[14])


@compiled
def intersect(ray: Vector, capsule: Capsule) -> float:
    """Return the depth (mm) at which a ray (x, y, 1) enters a capsule, inf if it misses."""
    if capsule.radius == 0.0:
        return np.inf
    nn, An, AA = capsule.nn, capsule.An, capsule.AA
    dd, dA, dn = dot(ray, ray), dot(ray, capsule.A), dot(ray, capsule.n)
    along = -1.0
    if nn > 0.0:  # the infinite cylinder
        a, half = nn * dd - dn * dn, An * dn - nn * dA
        h = half * half - a * (nn * AA - An * An)
        if h < 0.0:
            return np.inf
        t = -(half + np.sqrt(h)) / a
        along = t * dn - An
        if 0.0 < along < nn:
            return t if t > 0.0 else np.inf
    if along > 0.0:  # the ball at B, otherwise the one at A
        dA, AA = dA + dn, capsule.BB
    h = dA * dA - dd * AA
    if h < 0.0:
        return np.inf
    t = (dA - np.sqrt(h)) / dd
    return t if t > 0.0 else np.inf


@compiled
def find_first_capsule(ray: Vector, capsules: Capsules, pose: int, bits: int) -> tuple[int, float]:
    """Return the first capsule in the bit set `bits` that a ray meets in a pose, and its depth.

    The capsule is -1 if the ray meets none.
    """
    first, depth = -1, np.inf
    for k in range(4):
        if bits >> k & 1:
            t = intersect(ray, read_capsule(capsules, pose, k))
            if t < depth:
                first, depth = k, t
    return first, depth


@compiled
def distance_to_axis(p: Vector, u: Vector, capsule: Capsule) -> tuple[float, float]:
    """Return the least distance (mm) of the segment from p to p + u to a capsule's axis.

    The second number is the position of the nearest point on the segment, from 0 to 1.
    """
    n, nn = capsule.n, capsule.nn
    r = subtract(p, capsule.A)
    uu, un, ur, nr = dot(u, u), dot(u, n), dot(u, r), dot(n, r)
    determinant = uu * nn - un * un
    on_u = clip_fraction((un * nr - ur * nn) / determinant) if determinant > 0.0 else 0.0
    on_n = clip_fraction((un * on_u + nr) / nn) if nn > 0.0 else 0.0
    on_u = clip_fraction((un * on_n - ur) / uu)
    d = subtract(subtract(r, scale(-on_u, u)), scale(on_n, n))
    return np.sqrt(dot(d, d)), on_u


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Return a·b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def subtract(a: Vector, b: Vector) -> Vector:
    """Return a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def scale(s: float, a: Vector) -> Vector:
    """Return s a."""
    return s * a[0], s * a[1], s * a[2]


@compiled
def clip_fraction(fraction: float) -> float:
    """Clip a fraction to the range from 0 to 1."""
    return min(max(fraction, 0.0), 1.0)
