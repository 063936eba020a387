"""What the fitted projection foretells: places and motions in the picture, how well they are known,
and how well the picture tells the pose.
"""

import numpy as np

from rcmservo.estimation.projection_fit import UNIT, Foretold, Prospect, both, foretold
from rcmservo.geometry.features import about, features_jacobian
from rcmservo.geometry.kinematics import Point
from rcmservo.geometry.tool import Shaft, by_first_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import products
from rcmservo.numerics.small_solvers import invert


@compiled
def spread(v: Prospect, there: Foretold) -> tuple[float, float, float]:
    """Covariance px² of where the fit has the picture of a point: of u, of u with v, and of v."""
    x, (m_u, m_v), S, U, V = there.x, there.m, v.S_inverse, v.sums[1], v.sums[2]
    S_x = along(S[0], x), along(S[1], x), along(S[2], x), along(S[3], x)
    flat = x[0] * S_x[0] + x[1] * S_x[1] + x[2] * S_x[2] + x[3] * S_x[3]
    u_0, u_1, u_2 = along(U[0], S_x), along(U[1], S_x), along(U[2], S_x)
    v_0, v_1, v_2 = along(V[0], S_x), along(V[1], S_x), along(V[2], S_x)
    bend_u = u_0 - m_u * x[0], u_1 - m_u * x[1], u_2 - m_u * x[2]
    bend_v = v_0 - m_v * x[0], v_1 - m_v * x[1], v_2 - m_v * x[2]
    scale, G = v.noise / there.z**2, v.g_inverse
    uu, uv, vv = bent(G, bend_u, bend_u), bent(G, bend_u, bend_v), bent(G, bend_v, bend_v)
    return scale * (flat + uu), scale * uv, scale * (flat + vv)


@compiled
def along(row: Floats, x: tuple[float, float, float, float]) -> float:
    """Return the scalar product of a row (4,) and x."""
    return row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3] * x[3]


@compiled
def bent(G: Floats, a: Point, b: Point) -> float:
    """Return aᵀGb of G (3, 3)."""
    total = 0.0
    for i in range(3):
        total += a[i] * (G[i, 0] * b[0] + G[i, 1] * b[1] + G[i, 2] * b[2])
    return total


@compiled
def image(v: Prospect, p: Floats, place: Floats, covariance: Floats) -> None:
    """Write where the fit has the picture of a point p (3,) mm, (2,) raw px, of `RCM` the imaged
    RCM; and its covariance (2, 2) px².
    """
    there = foretold(v, p)
    uu, uv, vv = spread(v, there)
    place[0], place[1] = v.origin[3] + there.m[0], v.origin[4] + there.m[1]
    covariance[0, 0], covariance[0, 1], covariance[1, 0], covariance[1, 1] = uu, uv, uv, vv


@compiled
def imaged(v: Prospect, p: Floats) -> tuple[Floats, Floats]:
    """`image` as new arrays."""
    place, covariance = np.empty(2), np.empty((2, 2))
    image(v, p, place, covariance)
    return place, covariance


@compiled
def expect(v: Prospect, p1: Floats, shaft: Shaft, places: Floats) -> None:
    """Write the markers (2, 2) raw px at p1 (3,) mm by the fit alone."""
    one, other = both(v, p1, shaft)
    for i in range(2):
        places[0, i] = v.origin[3 + i] + one.m[i]
        places[1, i] = v.origin[3 + i] + other.m[i]


@compiled
def expected(v: Prospect, p1: Floats, shaft: Shaft) -> Floats:
    """`expect` as a new array."""
    places = np.empty((2, 2))
    expect(v, p1, shaft, places)
    return places


@compiled
def add_offset(v: Prospect, points: Floats) -> None:
    """Add what the fit leaves over of the markers lately to their places (2, 2) px."""
    for k in range(2):
        for i in range(2):
            points[k, i] += v.offset[k, i]


@compiled
def located(v: Prospect, p1: Floats, shaft: Shaft) -> Floats:
    """The markers (2, 2) raw px at p1 (3,) mm: fit and offset."""
    points = expected(v, p1, shaft)
    add_offset(v, points)
    return points


@compiled
def motion(v: Prospect, there: Foretold, jacobian: Floats) -> None:
    """Write ∂m/∂p (2, 3) px/mm of the fit at a point that it has `there`."""
    deep = there.z * UNIT
    for i in range(3):
        jacobian[0, i] = (v.A[0, i] - there.m[0] * v.g[i]) / deep
        jacobian[1, i] = (v.A[1, i] - there.m[1] * v.g[i]) / deep


@compiled
def motions(v: Prospect, p1: Floats | Point, shaft: Shaft, jacobian: Floats) -> None:
    """Write ∂m/∂p₁ (4, 3) px/mm of both markers, with marker 1 at p1 (3,) mm."""
    one, other = both(v, p1, shaft)
    motion(v, one, jacobian[:2])
    motion(v, other, jacobian[2:])
    by_first_marker(shaft, p1, jacobian[2:])


@compiled
def both_motions(v: Prospect, p1: Floats, shaft: Shaft) -> Floats:
    """`motions` as a new array."""
    jacobian = np.empty((4, 3))
    motions(v, p1, shaft, jacobian)
    return jacobian


@compiled
def features_motion(v: Prospect, p1: Floats, points: Floats, o_c: Floats, shaft: Shaft) -> Floats:
    """J (3, 3) of eq. (15): ∂y/∂m at raw `points` (2, 2) px about o_c, and ∂m/∂p₁ of the fit."""
    return products(features_jacobian(about(points, o_c)), both_motions(v, p1, shaft))


@compiled
def told_apart(H: Floats, back: Floats) -> bool:
    """Write (HᵀH)⁻¹ (3, 3) mm²/px² of both markers' motion H (4, 3) px/mm; whether it exists."""
    for i in range(3):
        for j in range(3):
            back[i, j] = 0.0
            for k in range(4):
                back[i, j] += H[k, i] * H[k, j]
    return invert(back)


@compiled
def weakness(v: Prospect, p1: Floats, shaft: Shaft) -> float:
    """tr(HᵀH)⁻¹ (mm/px)², with H = ∂m/∂p₁ of both markers: how badly their pixels tell the pose."""
    H, back = np.empty((4, 3)), np.empty((3, 3))
    motions(v, p1, shaft, H)
    return back[0, 0] + back[1, 1] + back[2, 2] if told_apart(H, back) else np.inf


@compiled
def pose_deviation(v: Prospect, p1: Floats, shaft: Shaft) -> float:
    """Standard deviation (mm) of marker 1 as the pixels of one frame tell it: σ √tr(HᵀH)⁻¹."""
    return np.sqrt(v.noise * weakness(v, p1, shaft))


@compiled
def deviation_without(v: Prospect, p1: Floats, k: int, shaft: Shaft) -> float:
    """Standard deviation (mm) of marker 1 where marker k (0 or 1) is not seen but put where the fit
    has it: √tr(H⁺ cov H⁺ᵀ), of the columns of H⁺ that are that marker's.
    """
    H, back, total = np.empty((4, 3)), np.empty((3, 3)), 0.0
    motions(v, p1, shaft, H)
    if not told_apart(H, back):
        return np.inf
    one, other = both(v, p1, shaft)
    uu, uv, vv = spread(v, one if k == 0 else other)
    for i in range(3):
        a, b = 0.0, 0.0
        for j in range(3):
            a += back[i, j] * H[2 * k, j]
            b += back[i, j] * H[2 * k + 1, j]
        total += uu * a * a + 2.0 * uv * a * b + vv * b * b
    return np.sqrt(total)


@compiled
def order(v: Prospect) -> float:
    """Of the way in the picture from marker 1 to marker 2, the share that a marker makes which
    moves from the place of the one to that of the other: about 1, and −1 where they are taken for
    each other.

    Its motion is taken from the motions of each marker by itself: the way from one to the other
    would tell it wrongly.
    """
    spread_x, moved, way = np.zeros((3, 3)), np.zeros((3, 2)), np.empty(5)
    for i in range(3):
        for j in range(3):
            spread_x[i, j] = v.sums[0, i, j]
        for n in range(2):
            moved[i, n] = v.sums[1 + n, i, 3]
        for k in range(2):
            share = v.apart[k, i] / v.apart[k, 5]
            for j in range(3):
                spread_x[i, j] -= share * v.apart[k, j]
            for n in range(2):
                moved[i, n] -= share * v.apart[k, 3 + n]
    sound = invert(spread_x)
    for i in range(5):
        way[i] = v.apart[1, i] / v.apart[1, 5] - v.apart[0, i] / v.apart[0, 5]
    along, apart = 0.0, way[3] ** 2 + way[4] ** 2
    for n in range(2):
        for i in range(3):
            for j in range(3):
                along += way[3 + n] * moved[i, n] * spread_x[i, j] * way[j]
    return along / apart if sound and apart > 0.0 else 0.0
