"""Which capsule each pixel sees.

Only tiles that a capsule may touch are visited. Each pixel there is looked at early and late in the
exposure, so that a pixel on an outline, or one that a capsule passes, is known.
"""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats, Image
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.rendering.capsules import (
    Capsule,
    Capsules,
    capsule_in,
    dot,
    gap,
    minus,
    nearest,
    plus,
    times,
)

TILE = 16
"""px, the side of a tile."""


def cones_of(optics: Optics) -> Floats:
    """For each tile the unit direction of its middle and the angle from there to its corners:
    (rows, columns, 4)."""
    low, high = -0.5, TILE - 0.5
    middle = _tile_rays(optics, TILE / 2 - 0.5, TILE / 2 - 0.5)
    corners = [_tile_rays(optics, du, dv) for du in (low, high) for dv in (low, high)]
    chord = np.max([np.linalg.norm(corner - middle, axis=-1) for corner in corners], axis=0)
    return np.concatenate([middle, 2 * np.arcsin(chord / 2)[..., None]], axis=-1)


def _tile_rays(optics: Optics, du: float, dv: float) -> Floats:
    """The unit direction of the pixel that is (du, dv) px from every tile's first one, (rows,
    columns, 3)."""
    v, u = (np.arange(0, size, TILE) for size in (optics.height, optics.width))
    edge = np.array([optics.width, optics.height]) - 0.5
    pixels = np.stack(np.meshgrid(u + du, v + dv), axis=-1)
    slopes = optics.slopes(np.minimum(pixels, edge))
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@compiled
def touch(cones: Floats, capsules: Capsules) -> Image:
    """For each tile the set of capsules, as bits, that any of its rays may meet in any pose.

    Turning a ray by an angle brings it nearer to a capsule by at most that angle times the way to
    the capsule's far end.
    """
    rows, columns = cones.shape[:2]
    touched = np.zeros((rows, columns), dtype=np.uint8)
    for k in range(4):
        capsule = capsule_in(capsules, 0, k)
        way, aside = capsule.radius + far_end(capsule), moved(capsules, k)
        for i in range(rows):
            for j in range(columns):
                middle = times(way, (cones[i, j, 0], cones[i, j, 1], cones[i, j, 2]))
                distance, _ = gap((0.0, 0.0, 0.0), middle, capsule)
                near = distance < capsule.radius + aside + way * cones[i, j, 3]
                if capsule.radius > 0.0 and near:
                    touched[i, j] |= 1 << k
    return touched


@compiled
def far_end(capsule: Capsule) -> float:
    """How far the farther end of a capsule's axis is from the camera, mm."""
    A, B = capsule.A, plus(capsule.A, capsule.n)
    return np.sqrt(max(dot(A, A), dot(B, B)))


@compiled
def moved(capsules: Capsules, k: int) -> float:
    """No point of capsule k's axis moves further than this from its mean pose, mm."""
    mean, most = capsule_in(capsules, 0, k), 0.0
    for pose in range(1, capsules.shape[0]):
        capsule = capsule_in(capsules, pose, k)
        at_a = minus(capsule.A, mean.A)
        at_b = minus(plus(capsule.A, capsule.n), plus(mean.A, mean.n))
        for i in range(3):
            most = max(most, at_a[i] ** 2, at_b[i] ** 2)
    return np.sqrt(3.0 * most)


@compiled
def identify(seen: Image, touched: Image, rays: Floats, capsules: Capsules) -> None:
    """Fill `seen` (2, H, W): which capsule a pixel sees first in the exposure, and which one later.

    A capsule counts from 1 to 4, the tissue is 0. The later one differs if the pixel sees another
    at all.
    """
    last = capsules.shape[0] - 1
    between = 1 if swift(capsules) else max(last - 1, 1)
    seen[:] = 0
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            which = touched[i, j]
            if which == 0:
                continue
            for y in range(i * TILE, min((i + 1) * TILE, rays.shape[0])):
                for x in range(j * TILE, min((j + 1) * TILE, rays.shape[1])):
                    ray = (rays[y, x, 0], rays[y, x, 1], 1.0)
                    first = later = nearest(ray, capsules, 1, which)[0]
                    pose = last
                    while later == first and pose > between:
                        later = nearest(ray, capsules, pose, which)[0]
                        pose -= 1
                    seen[0, y, x], seen[1, y, x] = 1 + first, 1 + later


@compiled
def swift(capsules: Capsules) -> bool:
    """Whether a capsule may pass a pixel within the exposure and cover it at neither end."""
    for k in range(4):
        first, last = capsule_in(capsules, 1, k), capsule_in(capsules, capsules.shape[0] - 1, k)
        at_a = minus(first.A, last.A)
        at_n = minus(first.n, last.n)
        way = np.sqrt(dot(at_a, at_a)) + np.sqrt(dot(at_n, at_n))
        if way > capsule_in(capsules, 0, k).radius > 0.0:
            return True
    return False


@compiled
def uniform(seen: Image, y: int, x: int) -> bool:
    """Whether pixel (y, x) and its neighbours see one and the same thing in the whole exposure."""
    body = seen[0, y, x]
    for v in range(max(y - 1, 0), min(y + 2, seen.shape[1])):
        for u in range(max(x - 1, 0), min(x + 2, seen.shape[2])):
            if seen[0, v, u] != body or seen[1, v, u] != body:
                return False
    return True
