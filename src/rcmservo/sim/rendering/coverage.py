"""Coverage: the capsule that each pixel shows, during an exposure in which the tool moves.

Only the tiles of the image that a capsule may touch are visited. Each pixel there is tested early
and late in the exposure, so that pixels on an outline, or passed by a capsule, are known.
"""

import numpy as np

from rcmservo.interfaces import Floats, Image
from rcmservo.numerics.jit import compiled
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.rendering.capsules import (
    Capsule,
    Capsules,
    add,
    distance_to_axis,
    dot,
    find_first_capsule,
    read_capsule,
    scale,
    subtract,
)

TILE_PX = 16
"""Side of a tile, px."""


def build_tile_cones(optics: CameraModel) -> Floats:
    """Return the cone (rows, columns, 4) that contains the rays of each tile.

    It consists of the unit vector through the tile's middle and the angle (rad) from there to the
    tile's corners.
    """
    low, high = -0.5, TILE_PX - 0.5
    middle = _compute_tile_rays(optics, TILE_PX / 2 - 0.5, TILE_PX / 2 - 0.5)
    corners = [_compute_tile_rays(optics, du, dv) for du in (low, high) for dv in (low, high)]
    chord = np.max([np.linalg.norm(corner - middle, axis=-1) for corner in corners], axis=0)
    return np.concatenate([middle, 2 * np.arcsin(chord / 2)[..., None]], axis=-1)


def _compute_tile_rays(optics: CameraModel, du: float, dv: float) -> Floats:
    """Return the unit vector (rows, columns, 3) through a pixel of every tile.

    The pixel is (du, dv) px from the tile's first one.
    """
    v, u = (np.arange(0, size, TILE_PX) for size in (optics.height, optics.width))
    edge = np.array([optics.width, optics.height]) - 0.5
    pixels = np.stack(np.meshgrid(u + du, v + dv), axis=-1)
    slopes = optics.slopes(np.minimum(pixels, edge))
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@compiled
def find_touched_tiles(cones: Floats, capsules: Capsules) -> Image:
    """Return for each tile the set of capsules, as bits, that its rays may meet in any pose.

    Rotating a ray by an angle moves it towards a capsule by at most that angle times the distance
    to the capsule's far end.
    """
    rows, columns = cones.shape[:2]
    touched = np.zeros((rows, columns), dtype=np.uint8)
    for k in range(4):
        capsule, motion = read_capsule(capsules, 0, k), bound_motion(capsules, k)
        far_distance = capsule.radius + compute_farthest_distance(capsule)
        for i in range(rows):
            for j in range(columns):
                middle = scale(far_distance, (cones[i, j, 0], cones[i, j, 1], cones[i, j, 2]))
                distance, _ = distance_to_axis((0.0, 0.0, 0.0), middle, capsule)
                is_near = distance < capsule.radius + motion + far_distance * cones[i, j, 3]
                if capsule.radius > 0.0 and is_near:
                    touched[i, j] |= 1 << k
    return touched


@compiled
def compute_farthest_distance(capsule: Capsule) -> float:
    """Return the distance (mm) from the camera to the farther end of a capsule's axis."""
    A, B = capsule.A, add(capsule.A, capsule.n)
    return np.sqrt(max(dot(A, A), dot(B, B)))


@compiled
def bound_motion(capsules: Capsules, k: int) -> float:
    """Return an upper bound (mm) of the motion of capsule `k`'s axis from its mean pose."""
    mean, largest = read_capsule(capsules, 0, k), 0.0
    for pose in range(1, capsules.shape[0]):
        capsule = read_capsule(capsules, pose, k)
        at_a = subtract(capsule.A, mean.A)
        at_b = subtract(add(capsule.A, capsule.n), add(mean.A, mean.n))
        for i in range(3):
            largest = max(largest, at_a[i] ** 2, at_b[i] ** 2)
    return np.sqrt(3.0 * largest)


@compiled
def identify_capsules(labels: Image, touched: Image, rays: Floats, capsules: Capsules) -> None:
    """Fill `labels` (2, H, W) with the capsule that a pixel shows first and a later one.

    Capsules are 1 to 4, the tissue is 0. The second label differs from the first one if the pixel
    shows something else at any tested time of the exposure.
    """
    last_pose = capsules.shape[0] - 1
    earliest_tested = 1 if may_skip_pixels(capsules) else max(last_pose - 1, 1)
    labels[:] = 0
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            bits = touched[i, j]
            if bits == 0:
                continue
            for y in range(i * TILE_PX, min((i + 1) * TILE_PX, rays.shape[0])):
                for x in range(j * TILE_PX, min((j + 1) * TILE_PX, rays.shape[1])):
                    ray = (rays[y, x, 0], rays[y, x, 1], 1.0)
                    first = later = find_first_capsule(ray, capsules, 1, bits)[0]
                    pose = last_pose
                    while later == first and pose > earliest_tested:
                        later = find_first_capsule(ray, capsules, pose, bits)[0]
                        pose -= 1
                    labels[0, y, x], labels[1, y, x] = 1 + first, 1 + later


@compiled
def may_skip_pixels(capsules: Capsules) -> bool:
    """Return True if a capsule may pass a pixel within the exposure and cover it at neither end."""
    for k in range(4):
        first, last = read_capsule(capsules, 1, k), read_capsule(capsules, capsules.shape[0] - 1, k)
        at_a = subtract(first.A, last.A)
        at_n = subtract(first.n, last.n)
        motion = np.sqrt(dot(at_a, at_a)) + np.sqrt(dot(at_n, at_n))
        if motion > read_capsule(capsules, 0, k).radius > 0.0:
            return True
    return False


@compiled
def is_uniform(labels: Image, y: int, x: int) -> bool:
    """Return True if pixel (y, x) and its neighbours show one capsule in the whole exposure."""
    label = labels[0, y, x]
    for v in range(max(y - 1, 0), min(y + 2, labels.shape[1])):
        for u in range(max(x - 1, 0), min(x + 2, labels.shape[2])):
            if labels[0, v, u] != label or labels[1, v, u] != label:
                return False
    return True
