"""Whether the markers are where the tool's motion puts them, and whether the estimate is right.

Every check is written so that NaN trips it.
"""

import numpy as np

from rcmservo.estimation.projection_fit import UNIT, Foretold, Prospect, both
from rcmservo.estimation.projection_prediction import spread
from rcmservo.geometry.features import SCALE, about, difference, features
from rcmservo.geometry.tool import Shaft
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import largest, length, minus, over, product
from rcmservo.safety.thresholds import Thresholds

NO_PIXEL = 1e6
"""px from where on a coordinate is no marker's."""


@compiled
def lost(points: Floats) -> tuple[bool, bool]:
    """Whether marker 1 and marker 2 are lost: raw pixels (2, 2) not finite, or such as no camera
    has.
    """
    first = abs(points[0, 0]) < NO_PIXEL and abs(points[0, 1]) < NO_PIXEL
    second = abs(points[1, 0]) < NO_PIXEL and abs(points[1, 1]) < NO_PIXEL
    return not first, not second


@compiled
def sound(v: Prospect, t: Thresholds) -> bool:
    """Whether the fit is that of a camera: what it leaves over is no more than noise, and its depth
    does not change faster than before any camera.
    """
    return v.noise <= t.left_over**2 and length(v.g) <= UNIT / t.nearest_camera


@compiled
def misplaced(
    v: Prospect, p1: Floats, points: Floats, before: Floats, shaft: Shaft, t: Thresholds
) -> tuple[bool, bool, bool]:
    """Whether marker 1, marker 2 are not where the camera should see them with marker 1 at p1 (3,)
    mm, and whether each is where the other should be. The newest frame believed had them at
    `before` (2, 2) px.
    """
    there, one, two = both(v, p1, shaft), False, False
    for k in range(2):
        off = doubtful(v, there[k], k, points[k], before[k], t)
        one, two = (off, two) if k == 0 else (one, off)
    crossed = one and two
    for k in range(2):
        crossed = crossed and not doubtful(v, there[k], k, points[1 - k], before[k], t)
    return one, two, crossed


@compiled
def doubtful(
    v: Prospect, there: Foretold, k: int, point: Floats, before: Floats, t: Thresholds
) -> bool:
    """Whether a `point` (2,) px is further from where marker k should be than noise, what the fit
    does not know, its errors and wrong times of a motion since `before` explain.
    """
    u = v.origin[3] + there.m[0] + v.offset[k, 0]
    w = v.origin[4] + there.m[1] + v.offset[k, 1]
    off_u, off_w = point[0] - u, point[1] - w
    distance = np.sqrt(off_u * off_u + off_w * off_w)
    way = np.sqrt((u - before[0]) ** 2 + (w - before[1]) ** 2)
    excess = distance - t.model_error - t.mistimed * way
    if excess <= 0.0:
        return False
    share, noise = excess / distance, v.noise * (1.0 + 1.0 / max(v.weight[k], 1.0))
    return not share * share * squared(off_u, off_w, spread(v, there), noise) <= t.innovation**2


@compiled
def squared(u: float, v: float, cov: tuple[float, float, float], noise: float) -> float:
    """xᵀ (C + noise I)⁻¹ x of x = (u, v) and the covariance C of u, of u with v, and of v."""
    uu, uv, vv = cov[0] + noise, cov[1], cov[2] + noise
    return (vv * u**2 - 2.0 * uv * u * v + uu * v**2) / (uu * vv - uv * uv)


@compiled
def leapt(
    points: Floats, before: Floats, way: float, jump: float, nearest: float
) -> tuple[bool, bool, bool]:
    """The same without an estimate: whether they moved further than any camera sees a tool move by
    `way` mm, which is `nearest` px a mm.
    """
    allowed = jump + nearest * way
    first, second = apart(points[0], before[0]), apart(points[1], before[1])
    crossed = apart(points[0], before[1]) <= allowed and apart(points[1], before[0]) <= allowed
    return not first <= allowed, not second <= allowed, crossed


@compiled
def apart(one: Floats, other: Floats) -> float:
    """Px between two points (2,)."""
    return np.sqrt((one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2)


@compiled
def judged(
    points: Floats,
    before: Floats,
    o_c: Floats,
    J_hat: Floats,
    delta_p: Floats,
    telling: float,
    wrong: float,
) -> int:
    """Whether the markers' change bears the estimate out (0) or not (1); −1 while the motion is too
    small to tell.
    """
    predicted = over(product(J_hat, delta_p), SCALE)
    size = largest(predicted)
    if size < telling:
        return -1
    change = difference(features(about(points, o_c)), features(about(before, o_c)))
    return 0 if largest(minus(over(change, SCALE), predicted)) <= telling + wrong * size else 1
