"""The tool as four capsules: shaft, jaw, and the balls 1 and 2, which are capsules without length.

`Capsules` is an array (1 + T, 4) of CAPSULE: the exposure's mean pose first, then its T moments.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.sim.optics import Optics
from rcmservo.sim.rendering.look import Look
from rcmservo.sim.rendering.vectors import Vector, clip, dot, minus, times

NEAR = 1.0
"""mm before the camera at which capsules are cut off."""

CAPSULE = np.dtype(
    [
        ("A", "f8", (3,)),  # mm, one end of the axis
        ("n", "f8", (3,)),  # mm, the way from A to the other end B
        ("radius", "f8"),  # mm, 0 for what is not there or wholly behind the camera
        ("nn", "f8"),  # mm², n·n
        ("An", "f8"),  # mm², A·n
        ("AA", "f8"),  # mm², A·A − radius²
        ("BB", "f8"),  # mm², B·B − radius²
        ("colour", "f8", (3,)),  # grey levels: blue, green, red
        ("highlight", "f8"),  # grey levels
    ]
)

Capsule = np.void
Capsules = NDArray[Any]


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
    result = np.empty(A.shape[:2], CAPSULE)
    result["A"], result["n"] = A, B - A
    result["radius"] = np.where((A[..., 2] > radius) & (B[..., 2] > radius), radius, 0.0)
    _multiply_out(result, B)
    result["colour"] = [look.shaft_colour, look.jaw_colour, *look.marker_colours]
    result["highlight"] = 255 * look.specular
    return result


def _multiply_out(capsules: Capsules, B: Floats) -> None:
    """Fill in the products that every ray needs."""
    A, n, r = capsules["A"], capsules["n"], capsules["radius"]
    capsules["nn"], capsules["An"] = (n * n).sum(-1), (A * n).sum(-1)
    capsules["AA"], capsules["BB"] = (A * A).sum(-1) - r**2, (B * B).sum(-1) - r**2


def _in_front(end: Floats, other: Floats, near: Floats) -> Floats:
    """`end`, moved along the axis to depth `near` if it is nearer and the `other` end is not."""
    depth, far = end[..., 2], other[..., 2]
    cut = (depth < near) & (far > near)
    share = np.where(cut, (near - depth) / np.where(cut, far - depth, 1), 0.0)
    return end + share[..., None] * (other - end)


@compiled
def start(capsule: Capsule) -> Vector:
    """A, one end of the axis."""
    A = capsule["A"]
    return A[0], A[1], A[2]


@compiled
def axis(capsule: Capsule) -> Vector:
    """n, the way from A to B."""
    n = capsule["n"]
    return n[0], n[1], n[2]


@compiled
def hit(ray: Vector, capsule: Capsule) -> float:
    """The depth at which a ray (x, y, 1) enters a capsule; inf if it passes by."""
    if capsule["radius"] == 0.0:
        return np.inf
    nn, An, AA = capsule["nn"], capsule["An"], capsule["AA"]
    dd, dA, dn = dot(ray, ray), dot(ray, start(capsule)), dot(ray, axis(capsule))
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
        dA, AA = dA + dn, capsule["BB"]
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
            t = hit(ray, capsules[pose, k])
            if t < depth:
                first, depth = k, t
    return first, depth


@compiled
def gap(p: Vector, u: Vector, capsule: Capsule) -> tuple[float, float]:
    """How near the segment from p to p + u comes to a capsule's axis, mm.

    The second number is where on the segment that is, from 0 to 1.
    """
    n, nn = axis(capsule), capsule["nn"]
    r = minus(p, start(capsule))
    uu, un, ur, nr = dot(u, u), dot(u, n), dot(u, r), dot(n, r)
    twist = uu * nn - un * un
    on_u = clip((un * nr - ur * nn) / twist) if twist > 0.0 else 0.0
    on_n = clip((un * on_u + nr) / nn) if nn > 0.0 else 0.0
    on_u = clip((un * on_n - ur) / uu)
    d = minus(minus(r, times(-on_u, u)), times(on_n, n))
    return np.sqrt(dot(d, d)), on_u
