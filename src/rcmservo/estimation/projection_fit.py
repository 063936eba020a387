"""What the camera should see: a projection fitted to all frames, with the covariance of what it
foretells.

    m = (A x̄) / (1 + gᵀx),    x = (p − p₀) / 100 mm,    x̄ = [x 1],    m in px from m₀

p₀ is the middle of the tool in the first frame and m₀ that of its markers there, so that the RCM
may lie before, in or behind the image plane, where (10) needs it before the camera. Both markers of
all frames count, each row of (18) weighted by w = 1/ẑ², so that its error is in pixels. Four sums
hold all of it,

    S = Σ w x̄x̄ᵀ,   U = Σ w u x̄x̄ᵀ,   V = Σ w v x̄x̄ᵀ,   W = Σ w (u² + v²) x̄x̄ᵀ

as for h = [g 1] the rows of A are S⁻¹U h and S⁻¹V h, and what they leave over is hᵀQh with Q = W −
U S⁻¹U − V S⁻¹V. Noise σ adds 2σ²S to W, which would pull g to zero; so g minimises hᵀ(Q − 2σ²S)h.
It is rule (21) with Γ = (Σ w WᵀW + Γ₀⁻¹)⁻¹ run to its end, without a choice of observations. The
transformation is that of Abdel-Aziz and Karara (1971), the correction that of errors in variables.

What the fit leaves over, averaged over the last frames near by, is the offset: fit and offset are
the markers without their noise.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.geometry.kinematics import Point
from rcmservo.geometry.tool import Shaft, second_marker, second_point
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, distance, fill, put
from rcmservo.numerics.small_solvers import invert
from rcmservo.numerics.structs import Row, part, real, reals

UNIT = 100.0
"""mm of one unit of x."""

LEAST_DEPTH = 0.2
"""Relative depth ẑ that a weight is made of at least."""

STEP = 0.3
"""mm of way of marker 1 from one frame that the sums take to the next: one place that is seen for
long must not outweigh the others."""

NEAR = 40.0
"""mm of way over which the offset fades to 1/e."""

FRAMES = 300.0
"""Frames that the offset is the mean of at most."""

NOISE = 0.5
"""px of noise that is expected before frames tell it,"""
NOISE_FRAMES = 5.0
"""and the number of frames that this counts for."""

SPOILT = 1.2
"""How many times as large what is left over may get by the correction for noise."""

RCM = np.zeros(3)
"""Where the RCM is, mm."""

PRIOR = 1e-6, 1.0
"""1/variance expected of A in px and of g before frames tell them."""


class FitWorkspace(Row):
    """Intermediate results of the fit. In the state they need no memory of their own."""

    x: Floats = reals(4, "", "x̄ of a marker")
    m: Floats = reals(2, "px", "its picture, from m₀")
    Q: Floats = reals((4, 4), "", "W − U S⁻¹U − V S⁻¹V")
    column: Floats = reals(4, "", "a column of S⁻¹U or S⁻¹V; U h or V h")
    h: Floats = reals(4, "", "g and 1")
    C: Floats = reals((3, 3), "", "(Q − 2σ²S)⁻¹ of g alone, corrected for noise")


class Prospect(Row):
    """All that the frames say of the projection."""

    sums: Floats = reals((4, 4, 4), "", "S, U, V, W")
    frames: float = real("", "how many frames they hold, one with one marker for a half")
    apart: Floats = reals((2, 6), "", "Σ w [x u v 1] of each marker by itself")
    origin: Floats = reals(5, "mm, px", "p₀ and m₀, NaN before the first frame")
    A: Floats = reals((2, 4), "px", "the numerators")
    g: Floats = reals(3, "", "the denominator")
    noise: float = real("px²", "σ², as what the fit leaves over tells it")
    S_inverse: Floats = reals((4, 4), "", "S⁻¹")
    g_inverse: Floats = reals((3, 3), "", "(Q − 2σ²S)⁻¹ of g alone")
    summed: Floats = reals(3, "mm", "p₁ of the newest frame in the sums")
    offset: Floats = reals((2, 2), "px", "that each marker is off the fit")
    weight: Floats = reals(2, "", "frames that the offset of each marker is the mean of")
    last: Floats = reals(3, "mm", "p₁ of the newest frame")
    work: FitWorkspace = part(FitWorkspace, "intermediate results of the newest fit")


class Foretold(NamedTuple):
    """Where the fit has the picture of a point.

    Parameters
    ----------
    x : tuple[float, float, float, float]
        x̄.
    m : tuple[float, float]
        px from m₀.
    z : float
        Its depth, in units of that of p₀.
    """

    x: tuple[float, float, float, float]
    m: tuple[float, float]
    z: float


def blank() -> Prospect:
    """No frame seen yet."""
    return Prospect.of(origin=np.nan, noise=NOISE**2)


@compiled
def empty(v: Prospect) -> None:
    """Forget all frames."""
    fill(v.sums, 0.0)
    fill(v.apart, 0.0)
    fill(v.origin, np.nan)
    fill(v.A, 0.0)
    fill(v.g, 0.0)
    fill(v.S_inverse, 0.0)
    fill(v.g_inverse, 0.0)
    fill(v.summed, 0.0)
    fill(v.offset, 0.0)
    fill(v.weight, 0.0)
    fill(v.last, 0.0)
    fill(v.work.x, 0.0)
    fill(v.work.m, 0.0)
    fill(v.work.Q, 0.0)
    fill(v.work.column, 0.0)
    fill(v.work.h, 0.0)
    fill(v.work.C, 0.0)
    v.frames, v.noise = 0.0, NOISE**2


@compiled
def foretold(v: Prospect, p: Floats | Point) -> Foretold:
    """Where the fit has the picture of a point p (3,) mm."""
    A, g, a = v.A, v.g, (p[0] - v.origin[0]) / UNIT
    b, c = (p[1] - v.origin[1]) / UNIT, (p[2] - v.origin[2]) / UNIT
    z = 1.0 + g[0] * a + g[1] * b + g[2] * c
    first = A[0, 0] * a + A[0, 1] * b + A[0, 2] * c + A[0, 3]
    second = A[1, 0] * a + A[1, 1] * b + A[1, 2] * c + A[1, 3]
    return Foretold((a, b, c, 1.0), (first / z, second / z), z)


@compiled
def both(v: Prospect, p1: Floats | Point, shaft: Shaft) -> tuple[Foretold, Foretold]:
    """Where the fit has the markers, with marker 1 at p1 (3,) mm."""
    return foretold(v, p1), foretold(v, second_point(shaft, p1))


@compiled
def take(v: Prospect, k: int, there: Foretold, points: Floats) -> None:
    """Take marker k, which the fit has `there`, into the sums, if it is not lost: raw `points`
    (2, 2) px.
    """
    if not all_finite(points[k]):
        return
    v.frames += 0.5
    x, m, weight = v.work.x, v.work.m, 1.0 / max(there.z, LEAST_DEPTH) ** 2
    x[0], x[1], x[2], x[3] = there.x
    for i in range(2):
        m[i] = points[k, i] - v.origin[3 + i]
    add(v, x, m, weight)
    add_apart(v, k, x, m, weight)


@compiled
def add(v: Prospect, x: Floats, m: Floats, weight: float) -> None:
    """Take one point into the sums: x̄ (4,) and its picture m (2,) px from m₀."""
    square = m[0] * m[0] + m[1] * m[1]
    for i in range(4):
        for j in range(4):
            w = weight * x[i] * x[j]
            v.sums[0, i, j] += w
            v.sums[1, i, j] += w * m[0]
            v.sums[2, i, j] += w * m[1]
            v.sums[3, i, j] += w * square


@compiled
def add_apart(v: Prospect, k: int, x: Floats, m: Floats, weight: float) -> None:
    """Take marker k into its own sums: x̄ (4,) and its picture m (2,) px from m₀."""
    for i in range(3):
        v.apart[k, i] += weight * x[i]
    for i in range(2):
        v.apart[k, 3 + i] += weight * m[i]
    v.apart[k, 5] += weight


@compiled
def left_over(v: Prospect, Q: Floats) -> None:
    """Write Q (4, 4)."""
    put(Q, v.sums[3])
    half = v.work.column
    for k in range(1, 3):
        for j in range(4):
            for i in range(4):
                total = 0.0
                for n in range(4):
                    total += v.S_inverse[i, n] * v.sums[k, n, j]
                half[i] = total
            for i in range(4):
                rest = Q[i, j]
                for n in range(4):
                    rest -= v.sums[k, i, n] * half[n]
                Q[i, j] = rest


@compiled
def denominator(v: Prospect, Q: Floats, correction: float, h: Floats, C: Floats) -> bool:
    """Write h = [g 1] (4,) with so much of the correction for noise, and the matrix C (3, 3) that g
    is known by; whether that exists.
    """
    for i in range(3):
        for j in range(3):
            C[i, j] = Q[i, j] - correction * v.sums[0, i, j]
        C[i, i] += PRIOR[1] * v.noise
    sound = invert(C)
    h[3] = 1.0
    for i in range(3):
        total = 0.0
        for j in range(3):
            total -= C[i, j] * (Q[j, 3] - correction * v.sums[0, j, 3])
        h[i] = total
    return sound


@compiled
def quadratic(M: Floats, h: Floats) -> float:
    """hᵀMh of M (4, 4) and h (4,)."""
    total = 0.0
    for i in range(4):
        for j in range(4):
            total += h[i] * M[i, j] * h[j]
    return total


@compiled
def fit(v: Prospect) -> None:
    """A, g and σ² from the sums.

    The correction for noise is that of what is left over without it, and it is taken only where
    what is left over hardly grows by it: a motion too short to tell g must not make it large.
    """
    put(v.S_inverse, v.sums[0])
    for i in range(4):
        v.S_inverse[i, i] += PRIOR[0] * v.noise
    invert(v.S_inverse)
    points, Q, h, C = 2.0 * v.frames, v.work.Q, v.work.h, v.work.C
    left_over(v, Q)
    denominator(v, Q, 0.0, h, v.g_inverse)
    rest = max(quadratic(Q, h), 0.0)
    put(v.g, h[:3])
    correction = rest / quadratic(v.sums[0], h) * max(1.0 - 4.0 / points, 0.0)
    if denominator(v, Q, correction, h, C) and quadratic(Q, h) <= SPOILT * rest:
        rest = quadratic(Q, h)
        put(v.g, h[:3])
        put(v.g_inverse, C)
    put(h[:3], v.g)
    for k in range(2):
        numerators(v, k, h)
    expected, rows = 4.0 * NOISE_FRAMES, max(2.0 * points - 11.0, 0.0)
    v.noise = (max(rest, 0.0) + expected * NOISE**2) / (rows + expected)


@compiled
def numerators(v: Prospect, k: int, h: Floats) -> None:
    """A row of A from h (4,): S⁻¹U h, or S⁻¹V h."""
    right = v.work.column
    for i in range(4):
        total = 0.0
        for j in range(4):
            total += v.sums[k + 1, i, j] * h[j]
        right[i] = total
    for i in range(4):
        total = 0.0
        for j in range(4):
            total += v.S_inverse[i, j] * right[j]
        v.A[k, i] = total


@compiled
def begin(v: Prospect, p1: Floats, p2: Floats, points: Floats) -> None:
    """p₀ and m₀ of the first frame."""
    for i in range(3):
        v.origin[i] = 0.5 * (p1[i] + p2[i])
    for i in range(2):
        v.origin[3 + i] = 0.5 * (points[0, i] + points[1, i])


@compiled
def see(v: Prospect, p1: Floats, points: Floats, shaft: Shaft) -> None:
    """Take in one frame: raw `points` (2, 2) px of the markers, with marker 1 at p1 (3,) mm. After
    the first, either may be NaN.
    """
    first = not v.frames > 0.0
    if first:
        begin(v, p1, second_marker(shaft, p1), points)
    if first or distance(p1, v.summed) >= STEP:
        there = both(v, p1, shaft)
        for k in range(2):
            take(v, k, there[k], points)
        fit(v)
        put(v.summed, p1)
    stays = 0.0 if first else np.exp(-distance(p1, v.last) / NEAR)
    there = both(v, p1, shaft)
    for k in range(2):
        settle(v, k, there[k], points[k], stays)
    put(v.last, p1)


@compiled
def settle(v: Prospect, k: int, there: Foretold, point: Floats, stays: float) -> None:
    """Let what is left over of marker k, which the fit has `there`, fade to the share that `stays`,
    and take in that of a raw `point` (2,) px, if it is not lost.
    """
    v.weight[k] *= stays
    if not all_finite(point):
        v.offset[k, 0], v.offset[k, 1] = stays * v.offset[k, 0], stays * v.offset[k, 1]
        return
    v.weight[k] = min(v.weight[k] + 1.0, FRAMES)
    for i in range(2):
        left = point[i] - v.origin[3 + i] - there.m[i]
        v.offset[k, i] += (left - v.offset[k, i]) / v.weight[k]
