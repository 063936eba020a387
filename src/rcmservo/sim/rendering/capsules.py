"""The tool as four capsules: shaft, jaw, and the balls 1 and 2, which are capsules without length.

`Capsules` is an array (1 + T, 4, 15): the exposure's mean pose first, then its T moments. A row
holds the numbers of one `Capsule`.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering.look import Look

NEAR = 1.0
"""mm before the camera at which capsules are cut off."""

Capsules = Floats

Vector = tuple[float, float, float]


class Capsule(NamedTuple):
    """One capsule in one pose, with the products that every ray needs."""

    A: Vector
    """mm, one end of the axis."""

    n: Vector
    """mm, the way from A to the other end B."""

    radius: float
    """mm; 0 for what is not there or wholly behind the camera."""

    nn: float
    """n·n."""

    An: float
    """A·n."""

    AA: float
    """A·A − radius²."""

    BB: float
    """B·B − radius²."""

    colour: Vector
    """Grey levels: blue, green, red."""

    highlight: float
    """Grey levels."""


def capsules_of(poses: Floats, optics: Optics, look: Look) -> Capsules:
    """The tool in each of `poses` (T, 4, 3), which are those of `Renderer.render`: (1 + T, 4).

    The shaft reaches half way from m2 to the tip, the thinner jaw from there on.
    """
    poses = np.concatenate([poses.mean(axis=0)[None], poses])
    m1, m2, start, tip = np.moveaxis((poses - optics.position) @ optics.rotation.T, 1, 0)
    wrist = (m2 + tip) / 2
    A = np.stack([start, wrist, m1, m2], axis=1)
    B = np.stack([wrist, tip, m1, m2], axis=1)
    radius = np.broadcast_to([look.shaft_radius, look.jaw_radius, *look.marker_radii], A.shape[:2])
    A, B = _in_front(A, B, radius + NEAR), _in_front(B, A, radius + NEAR)
    r = np.where((A[..., 2] > radius) & (B[..., 2] > radius), radius, 0.0)
    n = B - A
    products = [(n * n).sum(-1), (A * n).sum(-1), (A * A).sum(-1) - r**2, (B * B).sum(-1) - r**2]
    colours = np.broadcast_to([look.shaft_colour, look.jaw_colour, *look.marker_colours], A.shape)
    highlight = np.full_like(r, 255 * look.specular)
    numbers = np.stack([r, *products], axis=-1)
    return np.concatenate([A, n, numbers, colours, highlight[..., None]], axis=-1)


def _in_front(end: Floats, other: Floats, near: Floats) -> Floats:
    """`end`, moved along the axis to depth `near` if it is nearer and the `other` end is not."""
    depth, far = end[..., 2], other[..., 2]
    cut = (depth < near) & (far > near)
    share = np.where(cut, (near - depth) / np.where(cut, far - depth, 1), 0.0)
    return end + share[..., None] * (other - end)


@compiled
def capsule_in(capsules: Capsules, pose: int, k: int) -> Capsule:
    """Capsule k in a pose."""
    row = capsules[pose, k]
    return Capsule(
        (row[0], row[1], row[2]),
        (row[3], row[4], row[5]),
        row[6],
        row[7],
        row[8],
        row[9],
        row[10],
        (row[11], row[12], row[13]),
        row[14],
    )


@compiled
def hit(ray: Vector, capsule: Capsule) -> float:
    """The depth at which a ray (x, y, 1) enters a capsule; inf if it passes by."""
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
    if along > 0.0:  # the ball at B, else the one at A
        dA, AA = dA + dn, capsule.BB
    h = dA * dA - dd * AA
    if h < 0.0:
        return np.inf
    t = (dA - np.sqrt(h)) / dd
    return t if t > 0.0 else np.inf


@compiled
def nearest(ray: Vector, capsules: Capsules, pose: int, which: int) -> tuple[int, float]:
    """The first capsule of the bit set `which` that a ray meets in a pose, and its depth.

    The capsule is -1 if the ray meets none.
    """
    first, depth = -1, np.inf
    for k in range(4):
        if which >> k & 1:
            t = hit(ray, capsule_in(capsules, pose, k))
            if t < depth:
                first, depth = k, t
    return first, depth


@compiled
def gap(p: Vector, u: Vector, capsule: Capsule) -> tuple[float, float]:
    """How near the segment from p to p + u comes to a capsule's axis, mm.

    The second number is where on the segment that is, from 0 to 1.
    """
    n, nn = capsule.n, capsule.nn
    r = minus(p, capsule.A)
    uu, un, ur, nr = dot(u, u), dot(u, n), dot(u, r), dot(n, r)
    twist = uu * nn - un * un
    on_u = clip((un * nr - ur * nn) / twist) if twist > 0.0 else 0.0
    on_n = clip((un * on_u + nr) / nn) if nn > 0.0 else 0.0
    on_u = clip((un * on_n - ur) / uu)
    d = minus(minus(r, times(-on_u, u)), times(on_n, n))
    return np.sqrt(dot(d, d)), on_u


@compiled
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def times(s: float, a: Vector) -> Vector:
    return s * a[0], s * a[1], s * a[2]


@compiled
def clip(share: float) -> float:
    """The share, brought between 0 and 1."""
    return min(max(share, 0.0), 1.0)
