"""What the place and size of a ball in the picture tell of its place in space.

Size × depth is constant for a ball, so with its apparent radius R px at (u, v) px

    (u, v, 1)/R = C x̄,    x = (p − p₀) / 100 mm,    x̄ = [x 1],    u and v from m₀

is affine in its place p: twelve numbers C (3, 4), wherever the RCM is. p₀ and m₀ are the ball's
first place and picture. Noise of R is in all three rows, but in c₁ᵀx̄ − u c₃ᵀx̄ it is not: there
stands only that of u, over R. So what is least is, in px,

    Σ R² [(c₁ᵀx̄ − u c₃ᵀx̄)² + (c₂ᵀx̄ − v c₃ᵀx̄)²] + κ Σ R⁴ (c₃ᵀx̄ − 1/R)²

with κ the variance of a centre over that of a size. Six sums hold all of it,

    S = Σ R² x̄x̄ᵀ,   U = Σ R² u x̄x̄ᵀ,   V = Σ R² v x̄x̄ᵀ,   W = Σ R² (u² + v²) x̄x̄ᵀ,
    T = κ Σ R⁴ x̄x̄ᵀ,   t = κ Σ R³ x̄

as c₁ = S⁻¹U c₃ and c₂ = S⁻¹V c₃, and (Q + T) c₃ = t with Q = W − U S⁻¹U − V S⁻¹V. Noise σ of the
centres adds 2σ²S to W, which is taken off again. Without sizes this is the fit of
projection_fit.py.
"""

from typing import Any, NamedTuple, cast

import numpy as np

from rcmservo.estimation.projection_fit import NOISE, NOISE_FRAMES, STEP, UNIT
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, distance, dot, form, product, put
from rcmservo.numerics.small_solvers import invert, solve_3x3
from rcmservo.numerics.structs import Row, Rows, real, reals

ENOUGH = 4.0
"""Places of the ball that its twelve numbers need at least."""

PRIOR = 1e-6, 1.0
"""1/variance expected of c₁ and c₂ in px/R and of c₃ in 1/R before frames tell them."""


class SizedBall(Row):
    """All that the frames say of one ball."""

    sums: Floats = reals((5, 4, 4), "", "S, U, V, W, T")
    sizes: Floats = reals(4, "", "t")
    frames: float = real("", "how many frames they hold")
    origin: Floats = reals(5, "mm, px", "p₀ and m₀")
    C: Floats = reals((3, 4), "", "C, of which the last row is in 1/px")
    noise: float = real("px²", "σ², as what the fit leaves over tells it")
    S_inverse: Floats = reals((4, 4), "", "S⁻¹")
    c_inverse: Floats = reals((4, 4), "", "(Q − 2σ²S + T)⁻¹")
    summed: Floats = reals(3, "mm", "p of the newest frame in the sums")


class Pictured(NamedTuple):
    """What the fit has of the picture of a point.

    Parameters
    ----------
    x : Floats
        (4,) x̄.
    m : Floats
        (2,) px from m₀.
    shrink : float
        1/R, in 1/px, that a ball would have there.
    """

    x: Floats
    m: Floats
    shrink: float


def no_balls() -> Rows[SizedBall]:
    """Two balls that were never seen."""
    one = SizedBall.of(noise=NOISE**2).rows
    return cast(Any, np.repeat(cast(Any, one), 2))


@compiled
def pictured(b: SizedBall, p: Floats) -> Pictured:
    """What the fit has of the picture of a point p (3,) mm."""
    x = np.ones(4)
    for i in range(3):
        x[i] = (p[i] - b.origin[i]) / UNIT
    w = product(b.C, x)
    return Pictured(x, np.array([w[0] / w[2], w[1] / w[2]]), w[2])


@compiled
def see_ball(b: SizedBall, p: Floats, point: Floats, size: float, kappa: float) -> None:
    """Take in one frame with the ball at p (3,) mm, seen at a raw `point` (2,) px with an apparent
    radius of `size` px; nothing of it where one of them is not known.
    """
    if not (all_finite(p) and all_finite(point) and np.isfinite(size) and size > 0.0):
        return
    if not b.frames > 0.0:
        put(b.origin[:3], p)
        put(b.origin[3:], point)
    elif distance(p, b.summed) < STEP:
        return
    x, m = np.ones(4), np.empty(2)
    for i in range(3):
        x[i] = (p[i] - b.origin[i]) / UNIT
    for k in range(2):
        m[k] = point[k] - b.origin[3 + k]
    add_ball(b, x, m, size, kappa)
    b.frames += 1.0
    put(b.summed, p)
    fit_ball(b, size, kappa)


@compiled
def add_ball(b: SizedBall, x: Floats, m: Floats, size: float, kappa: float) -> None:
    """Take one picture into the sums: x̄ (4,), and m (2,) px from m₀."""
    shares = size**2, size**2 * m[0], size**2 * m[1], (size * m[0]) ** 2 + (size * m[1]) ** 2
    for i in range(4):
        b.sizes[i] += kappa * size**3 * x[i]
        for j in range(4):
            both = x[i] * x[j]
            for k in range(4):
                b.sums[k, i, j] += shares[k] * both
            b.sums[4, i, j] += kappa * size**4 * both


@compiled
def fit_ball(b: SizedBall, size: float, kappa: float) -> None:
    """C and σ² from the sums, with priors for a ball of `size` px."""
    put(b.S_inverse, b.sums[0])
    for i in range(4):
        b.S_inverse[i, i] += PRIOR[0] * b.noise * size**2
    invert(b.S_inverse)
    Q = centres_left(b)
    c, narrow, _ = third_row(b, Q, 0.0, size)
    rest = max(form(Q, c, c), 0.0)
    correction = rest / form(b.sums[0], c, c) * max(1.0 - 4.0 / b.frames, 0.0)
    corrected, narrower, sound = third_row(b, Q, correction, size)
    if sound:
        c, narrow, rest = corrected, narrower, max(form(Q, corrected, corrected), 0.0)
    put(b.C[2], c)
    put(b.c_inverse, narrow)
    for k in range(2):
        put(b.C[k], product(b.S_inverse, product(b.sums[k + 1], c)))
    rest += max(form(b.sums[4], c, c) + kappa * b.frames - 2.0 * dot(b.sizes, c), 0.0)
    expected, rows = 3.0 * NOISE_FRAMES, max(3.0 * b.frames - 12.0, 0.0)
    b.noise = (rest + expected * NOISE**2) / (rows + expected)


@compiled
def centres_left(b: SizedBall) -> Floats:
    """Q (4, 4): what the centres leave over of a third row of C."""
    Q = b.sums[3].copy()
    for k in range(1, 3):
        for j in range(4):
            half = product(b.S_inverse, b.sums[k, j])
            for i in range(4):
                Q[i, j] -= dot(b.sums[k, i], half)
    return Q


@compiled
def third_row(
    b: SizedBall, Q: Floats, correction: float, size: float
) -> tuple[Floats, Floats, bool]:
    """c₃ (4,) with so much of S taken off Q, the matrix (4, 4) that it is known by, and whether
    that exists.
    """
    M = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            M[i, j] = Q[i, j] - correction * b.sums[0, i, j] + b.sums[4, i, j]
        M[i, i] += PRIOR[1] * b.noise * size**2 if i < 3 else 0.0
    sound = invert(M)
    return product(M, b.sizes), M, sound


@compiled
def place_told(b: SizedBall, point: Floats, size: float) -> tuple[Floats, bool]:
    """P (3,) mm of the ball that is seen at a raw `point` (2,) px with a radius of `size` px, and
    whether the fit tells it: C₁₋₃ x = (u, v, 1)/R − C₄.
    """
    w, p = np.empty(3), b.origin[:3].copy()
    for k in range(2):
        w[k] = (point[k] - b.origin[3 + k]) / size - b.C[k, 3]
    w[2] = 1.0 / size - b.C[2, 3]
    x, _ = solve_3x3(b.C, w)
    for i in range(3):
        p[i] += UNIT * x[i]
    return p, b.frames >= ENOUGH and all_finite(p)


@compiled
def motion_of(b: SizedBall, p: Floats) -> Floats:
    """∂m/∂p (2, 3) px/mm of the fit at a point p (3,) mm."""
    there, jacobian = pictured(b, p), np.empty((2, 3))
    for k in range(2):
        for i in range(3):
            jacobian[k, i] = (b.C[k, i] - there.m[k] * b.C[2, i]) / (there.shrink * UNIT)
    return jacobian


@compiled
def size_motion_of(b: SizedBall, p: Floats) -> Floats:
    """∂R/∂p = −R² c₃ / 100 mm, (3,) px/mm, of the fit at a point p (3,) mm: 1/R = c₃ᵀx̄."""
    there, slope = pictured(b, p), np.empty(3)
    for i in range(3):
        slope[i] = -b.C[2, i] / (there.shrink**2 * UNIT)
    return slope


@compiled
def image_of(b: SizedBall, p: Floats) -> tuple[Floats, Floats]:
    """Where the fit has the picture of a point p (3,) mm, (2,) raw px, and its covariance (2, 2)
    px².
    """
    there, place = pictured(b, p), np.empty(2)
    bend, S_x = np.empty((2, 4)), product(b.S_inverse, there.x)
    for k in range(2):
        place[k] = b.origin[3 + k] + there.m[k]
        put(bend[k], product(b.sums[1 + k], S_x))
        for i in range(4):
            bend[k, i] -= there.m[k] * there.x[i]
    cov, scale = np.empty((2, 2)), b.noise / there.shrink**2
    for k in range(2):
        known = product(b.c_inverse, bend[k])
        for n in range(2):
            flat = dot(there.x, S_x) if k == n else 0.0
            cov[k, n] = scale * (flat + dot(bend[n], known))
    return place, cov
