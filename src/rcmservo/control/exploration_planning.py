"""Where to explore next, and whether it is enough: how well the fit tells the way to the target.

The fit has eleven numbers θ, the rows of A and g. With D = ∂m/∂θ (4, 11) of both markers at a
place, frames at many places tell them with the covariance

    σ² N⁻¹,    N = Σ DᵀD + N₀

of which the sums hold all but the prior N₀. The way to the target is H⁺(m_d − m), with H = ∂m/∂p₁.
Where the fit errs by δθ it is off by T δθ, T = H⁺(D(p₁ + way) − D(p₁)), so its error is expected
to be σ √tr(T N⁻¹Tᵀ). Of a long way only the first `AHEAD` mm count, in proportion: more is learnt
while the tool goes them.

A leg from p to p' adds to N what frames along it would, by Simpson's rule. So the next corner is
that which leaves the least expected error, of those of the round's box about the start, and
between them, that lie inside the joint limits and not too far away.
"""

import numpy as np

from rcmservo.control.exploration import LIMIT_MARGIN, Exploration, Exploring, at
from rcmservo.estimation.projection_fit import LEAST_DEPTH, PRIOR, Foretold, Prospect, both
from rcmservo.estimation.projection_prediction import motions, told_apart
from rcmservo.geometry.kinematics import Point, Rcm, apart, point_at
from rcmservo.geometry.tool import Shaft
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import fill, length, put
from rcmservo.numerics.small_solvers import invert

AHEAD = 10.0
"""mm of the way to the target over which its error is told."""

CLOSE = 0.5
"""mm of error that do not matter, however short the way is."""

PLACES = 27
"""Corners to choose from: every joint at the start, or a side of the box from it."""


@compiled
def slopes(there: Foretold, D: Floats) -> None:
    """Write ∂m/∂θ (2, 11) of a point that the fit has `there`."""
    fill(D, 0.0)
    for k in range(2):
        for i in range(4):
            D[k, 4 * k + i] = there.x[i] / there.z
        for i in range(3):
            D[k, 8 + i] = -there.m[k] * there.x[i] / there.z


@compiled
def both_slopes(v: Prospect, p1: Point, shaft: Shaft, D: Floats) -> bool:
    """Write ∂m/∂θ (4, 11) of both markers, with marker 1 at p1 (3,) mm; whether they lie before the
    camera by the fit.
    """
    one, other = both(v, p1, shaft)
    slopes(one, D[:2])
    slopes(other, D[2:])
    return one.z > LEAST_DEPTH and other.z > LEAST_DEPTH


@compiled
def information(v: Prospect, N: Floats) -> None:
    """Write N (11, 11) of the frames so far, and the prior."""
    fill(N, 0.0)
    for k in range(2):
        for i in range(4):
            for j in range(4):
                N[4 * k + i, 4 * k + j] = v.sums[0, i, j]
            for j in range(3):
                N[4 * k + i, 8 + j] = -v.sums[1 + k, i, j]
                N[8 + j, 4 * k + i] = -v.sums[1 + k, i, j]
            N[4 * k + i, 4 * k + i] += PRIOR[0] * v.noise
    for i in range(3):
        for j in range(3):
            N[8 + i, 8 + j] = v.sums[3, i, j]
        N[8 + i, 8 + i] += PRIOR[1] * v.noise


@compiled
def add_leg(v: Prospect, p: Point, to: Point, frames: float, shaft: Shaft, N: Floats) -> None:
    """Add so many frames to N (11, 11), seen on a straight way of marker 1 from p to `to`, both
    (3,) mm.
    """
    D = np.empty((4, 11))
    for k in range(3):
        part = 0.5 * k
        x, y, z = to[0] - p[0], to[1] - p[1], to[2] - p[2]
        place = p[0] + part * x, p[1] + part * y, p[2] + part * z
        both_slopes(v, place, shaft, D)
        weight = frames * (4.0 if k == 1 else 1.0) / 6.0
        for n in range(4):
            for i in range(11):
                for j in range(11):
                    N[i, j] += weight * D[n, i] * D[n, j]


@compiled
def way_of(v: Prospect, p1: Point, target: Floats, shaft: Shaft, T: Floats) -> float:
    """Write T (3, 11), mm a unit of θ, from marker 1 at p1 (3,) mm to the `target` (2, 2) raw px;
    how long that way is, mm, infinite where the fit does not tell it.
    """
    H, back, D = np.empty((4, 3)), np.empty((3, 3)), np.empty((4, 11))
    there, way, pull = np.empty((4, 11)), np.empty(3), np.empty((3, 4))
    motions(v, p1, shaft, H)
    if not told_apart(H, back):
        return np.inf
    one, other = both(v, p1, shaft)
    fill(way, 0.0)
    for i in range(3):
        for n in range(4):
            pull[i, n] = back[i, 0] * H[n, 0] + back[i, 1] * H[n, 1] + back[i, 2] * H[n, 2]
        for j in range(2):
            seen_one = v.origin[3 + j] + one.m[j] + v.offset[0, j]
            seen_other = v.origin[3 + j] + other.m[j] + v.offset[1, j]
            way[i] += pull[i, j] * (target[0, j] - seen_one)
            way[i] += pull[i, 2 + j] * (target[1, j] - seen_other)
    far = length(way)
    part = AHEAD / far if far > AHEAD else 1.0
    ahead = p1[0] + part * way[0], p1[1] + part * way[1], p1[2] + part * way[2]
    if not (both_slopes(v, p1, shaft, D) and both_slopes(v, ahead, shaft, there)):
        return np.inf
    for i in range(3):
        for j in range(11):
            T[i, j] = 0.0
            for n in range(4):
                T[i, j] += pull[i, n] * (there[n, j] - D[n, j]) / part
    return far


@compiled
def error_of(T: Floats, N: Floats, noise: float) -> float:
    """σ √tr(T N⁻¹Tᵀ) mm of T (3, 11), N (11, 11) and σ² px²; infinite where N tells too little."""
    back, total = np.empty((11, 11)), 0.0
    put(back, N)
    if not invert(back):
        return np.inf
    for k in range(3):
        for i in range(11):
            for j in range(11):
                total += T[k, i] * back[i, j] * T[k, j]
    return np.sqrt(noise * total)


@compiled
def off_target(v: Prospect, p1: Floats, target: Floats, shaft: Shaft) -> tuple[float, float]:
    """By how many mm the way from marker 1 at p1 (3,) mm to the `target` (2, 2) raw px is mistaken,
    one standard deviation, and how long it is; infinite where the fit does not tell it.
    """
    T, N = np.empty((3, 11)), np.empty((11, 11))
    far = way_of(v, (p1[0], p1[1], p1[2]), target, shaft, T)
    if not far < np.inf:
        return np.inf, np.inf
    information(v, N)
    return error_of(T, N, v.noise), far


@compiled
def directed(v: Prospect, p1: Floats, target: Floats, shaft: Shaft, x: Exploration) -> bool:
    """Whether the direction from marker 1 at p1 (3,) mm to the `target` (2, 2) raw px is known:
    the error of the way is at most the share `uncertainty` of it, or so small that it does not
    matter.
    """
    error, far = off_target(v, p1, target, shaft)
    return error < np.inf and error <= max(x.uncertainty * far, CLOSE)


@compiled
def place_of(tour: Exploring, number: int, rcm: Rcm, q: Floats) -> bool:
    """Write the joints (3,) of one of the `PLACES`; whether the limits allow it."""
    for i in range(3):
        step, margin = number % 3 - 1, LIMIT_MARGIN * (rcm.upper[i] - rcm.lower[i])
        number //= 3
        q[i] = tour.home[i] + step * tour.sides[i]
        if step != 0 and not rcm.lower[i] + margin <= q[i] <= rcm.upper[i] - margin:
            return False
    return True


@compiled
def plan(
    tour: Exploring, v: Prospect, rcm: Rcm, shaft: Shaft, q: Floats, target: Floats, reach: float
) -> None:
    """Make that of the `PLACES` the next corner which leaves the least error of the way from the
    joints q (3,) to the `target` (2, 2) raw px, of those at most `reach` mm away; leave the corner
    as it is where none does.
    """
    T, N, M = np.empty((3, 11)), np.empty((11, 11)), np.empty((11, 11))
    p, corner, least = point_at(rcm, q), np.empty(3), np.inf
    if not way_of(v, p, target, shaft, T) < np.inf:
        return
    information(v, N)
    frames = v.frames / tour.visits
    for number in range(PLACES):
        if not place_of(tour, number, rcm, corner) or at(corner, tour.sides, q):
            continue
        to = point_at(rcm, corner)
        if apart(p, to) <= reach:
            put(M, N)
            add_leg(v, p, to, frames, shaft, M)
            error = error_of(T, M, v.noise)
            if error < least:
                least = error
                put(tour.goal, corner)
