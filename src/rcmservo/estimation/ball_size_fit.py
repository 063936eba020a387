"""Fit of an affine model to the pixels and the apparent size of one marker, which is a ball.

The product of apparent size and depth is constant for a ball. With its apparent radius R px at
(u, v) px,

    (u, v, 1)/R = C x̄,    x = (p − p₀) / 100 mm,    x̄ = [x 1],    u and v from m₀

is affine in the ball's position p: twelve numbers C (3, 4), for any position of the RCM. p₀ and m₀
are the ball's position and pixels in the first frame. Noise of R enters all three rows, but not
c₁ᵀx̄ − u c₃ᵀx̄, which has only the noise of u, divided by R. The fit therefore minimises, in px,

    Σ R² [(c₁ᵀx̄ − u c₃ᵀx̄)² + (c₂ᵀx̄ − v c₃ᵀx̄)²] + κ Σ R⁴ (c₃ᵀx̄ − 1/R)²

with κ the variance of a centre divided by that of a size. Six sums suffice,

    S = Σ R² x̄x̄ᵀ,   U = Σ R² u x̄x̄ᵀ,   V = Σ R² v x̄x̄ᵀ,   W = Σ R² (u² + v²) x̄x̄ᵀ,
    T = κ Σ R⁴ x̄x̄ᵀ,   t = κ Σ R³ x̄

since c₁ = S⁻¹U c₃ and c₂ = S⁻¹V c₃, and (Q + T) c₃ = t with Q = W − U S⁻¹U − V S⁻¹V. Noise σ of the
centres adds 2σ²S to W; the fit subtracts it. Without sizes this is the fit of camera_fit.py.
"""

from typing import Any, NamedTuple, cast

import numpy as np

from rcmservo.estimation.camera_fit import (
    MIN_FRAME_SPACING_MM,
    PRIOR_NOISE_FRAMES,
    PRIOR_NOISE_PX,
    UNIT_LENGTH_MM,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import (
    all_finite,
    bilinear_form,
    compute_distance,
    copy_into,
    dot,
    multiply_vector,
)
from rcmservo.numerics.small_solvers import invert, solve_3x3
from rcmservo.numerics.structs import Row, Rows, real, reals

PARAMETER_COUNT = 12.0
"""Number of parameters of the model, C."""

MIN_FRAMES = 4.0
"""Smallest number of frames at different positions that determines C."""

PRIOR_PRECISION = 1e-6, 1.0
"""Prior precision 1/variance of c₁ and c₂ (px/R), and of c₃ (1/R)."""


class BallFit(Row):
    """Fit of one ball: the sums over its frames and the solution."""

    sums: Floats = reals((5, 4, 4), "", "S, U, V, W, T")
    size_sums: Floats = reals(4, "", "t")
    frame_count: float = real("", "number of frames in the sums")
    origin: Floats = reals(5, "mm, px", "p₀ and m₀")
    C: Floats = reals((3, 4), "", "C; its last row is in 1/px")
    noise_variance: float = real("px²", "σ² by the residuals of the fit")
    S_inverse: Floats = reals((4, 4), "", "S⁻¹")
    c_inverse: Floats = reals((4, 4), "", "(Q − 2σ²S + T)⁻¹")
    newest_p: Floats = reals(3, "mm", "p of the newest frame in the sums")


class BallImage(NamedTuple):
    """Predicted image of a point.

    Parameters
    ----------
    x : Floats
        x̄ (4,).
    m : Floats
        Pixels (2,) from m₀.
    inverse_radius : float
        1/R in 1/px of a ball at the point.
    """

    x: Floats
    m: Floats
    inverse_radius: float


def make_initial_ball_fits() -> Rows[BallFit]:
    """Return the fits of two balls before the first frame."""
    empty = BallFit.of(noise_variance=PRIOR_NOISE_PX**2).rows
    return cast(Any, np.repeat(cast(Any, empty), 2))


@compiled
def project_ball(fit: BallFit, p: Floats) -> BallImage:
    """Return the predicted image of a ball at p (3,) mm."""
    x = normalise_position(fit, p)
    w = multiply_vector(fit.C, x)
    return BallImage(x, np.array([w[0] / w[2], w[1] / w[2]]), w[2])


@compiled
def normalise_position(fit: BallFit, p: Floats) -> Floats:
    """Return x̄ (4,) of a position p (3,) mm."""
    x = np.ones(4)
    for i in range(3):
        x[i] = (p[i] - fit.origin[i]) / UNIT_LENGTH_MM
    return x


@compiled
def update_ball_fit(fit: BallFit, p: Floats, point: Floats, size: float, kappa: float) -> None:
    """Update the fit by one frame with the ball at p (3,) mm.

    The ball has the raw `point` (2,) px and the apparent radius `size` px. A frame in which one of
    them is unknown is ignored, and so is one closer than MIN_FRAME_SPACING_MM to the previous one.
    """
    if not (all_finite(p) and all_finite(point) and np.isfinite(size) and size > 0.0):
        return
    if not fit.frame_count > 0.0:
        copy_into(fit.origin[:3], p)
        copy_into(fit.origin[3:], point)
    elif compute_distance(p, fit.newest_p) < MIN_FRAME_SPACING_MM:
        return
    x, m = normalise_position(fit, p), np.empty(2)
    for k in range(2):
        m[k] = point[k] - fit.origin[3 + k]
    add_to_sums(fit, x, m, size, kappa)
    fit.frame_count += 1.0
    copy_into(fit.newest_p, p)
    solve_ball_fit(fit, size, kappa)


@compiled
def add_to_sums(fit: BallFit, x: Floats, m: Floats, size: float, kappa: float) -> None:
    """Add one frame with x̄ (4,) and m (2,) px from m₀ to the sums."""
    weights = size**2, size**2 * m[0], size**2 * m[1], (size * m[0]) ** 2 + (size * m[1]) ** 2
    for i in range(4):
        fit.size_sums[i] += kappa * size**3 * x[i]
        for j in range(4):
            product = x[i] * x[j]
            for k in range(4):
                fit.sums[k, i, j] += weights[k] * product
            fit.sums[4, i, j] += kappa * size**4 * product


@compiled
def solve_ball_fit(fit: BallFit, size: float, kappa: float) -> None:
    """Solve for C and σ² from the sums, with priors for a ball of the radius `size` px."""
    copy_into(fit.S_inverse, fit.sums[0])
    for i in range(4):
        fit.S_inverse[i, i] += PRIOR_PRECISION[0] * fit.noise_variance * size**2
    invert(fit.S_inverse)
    Q = compute_residual_form(fit)
    c, inverse, _ = solve_third_row(fit, Q, 0.0, size)
    residual = max(bilinear_form(Q, c, c), 0.0)
    # each row of C has four parameters, which reduce the residuals
    unexplained_fraction = max(1.0 - 4.0 / fit.frame_count, 0.0)
    correction = residual / bilinear_form(fit.sums[0], c, c) * unexplained_fraction
    corrected, corrected_inverse, is_invertible = solve_third_row(fit, Q, correction, size)
    if is_invertible:
        c, inverse = corrected, corrected_inverse
        residual = max(bilinear_form(Q, c, c), 0.0)
    copy_into(fit.C[2], c)
    copy_into(fit.c_inverse, inverse)
    for k in range(2):
        copy_into(fit.C[k], multiply_vector(fit.S_inverse, multiply_vector(fit.sums[k + 1], c)))
    size_residual = bilinear_form(fit.sums[4], c, c) + kappa * fit.frame_count
    residual += max(size_residual - 2.0 * dot(fit.size_sums, c), 0.0)
    prior_rows = 3.0 * PRIOR_NOISE_FRAMES
    free_rows = max(3.0 * fit.frame_count - PARAMETER_COUNT, 0.0)
    prior_residual = prior_rows * PRIOR_NOISE_PX**2
    fit.noise_variance = (residual + prior_residual) / (free_rows + prior_rows)


@compiled
def compute_residual_form(fit: BallFit) -> Floats:
    """Return Q = W − U S⁻¹U − V S⁻¹V (4, 4); c₃ᵀQc₃ is the centres' sum of squared residuals."""
    Q = fit.sums[3].copy()
    for k in range(1, 3):
        for j in range(4):
            S_inverse_column = multiply_vector(fit.S_inverse, fit.sums[k, j])
            for i in range(4):
                Q[i, j] -= dot(fit.sums[k, i], S_inverse_column)
    return Q


@compiled
def solve_third_row(
    fit: BallFit, Q: Floats, correction: float, size: float
) -> tuple[Floats, Floats, bool]:
    """Return c₃ (4,), the inverse (4, 4) that it is solved with, and whether that inverse exists.

    Q is reduced by `correction` times S.
    """
    M = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            M[i, j] = Q[i, j] - correction * fit.sums[0, i, j] + fit.sums[4, i, j]
        M[i, i] += PRIOR_PRECISION[1] * fit.noise_variance * size**2 if i < 3 else 0.0
    is_invertible = invert(M)
    return multiply_vector(M, fit.size_sums), M, is_invertible


@compiled
def locate_ball(fit: BallFit, point: Floats, size: float) -> tuple[Floats, bool]:
    """Return the position (3,) mm of the ball, and whether the fit determines it.

    The ball has the raw `point` (2,) px and the radius `size` px: C₁₋₃ x = (u, v, 1)/R − C₄.
    """
    w, p = np.empty(3), fit.origin[:3].copy()
    for k in range(2):
        w[k] = (point[k] - fit.origin[3 + k]) / size - fit.C[k, 3]
    w[2] = 1.0 / size - fit.C[2, 3]
    x, _ = solve_3x3(fit.C, w)
    for i in range(3):
        p[i] += UNIT_LENGTH_MM * x[i]
    return p, fit.frame_count >= MIN_FRAMES and all_finite(p)


@compiled
def compute_ball_jacobian(fit: BallFit, p: Floats) -> Floats:
    """Return ∂m/∂p (2, 3) px/mm of the fit at p (3,) mm."""
    image, jacobian = project_ball(fit, p), np.empty((2, 3))
    unit = image.inverse_radius * UNIT_LENGTH_MM
    for k in range(2):
        for i in range(3):
            jacobian[k, i] = (fit.C[k, i] - image.m[k] * fit.C[2, i]) / unit
    return jacobian


@compiled
def compute_radius_jacobian(fit: BallFit, p: Floats) -> Floats:
    """Return ∂R/∂p = −R² c₃ / 100 mm, (3,) px/mm, of the fit at p (3,) mm, by 1/R = c₃ᵀx̄."""
    image, jacobian = project_ball(fit, p), np.empty(3)
    for i in range(3):
        jacobian[i] = -fit.C[2, i] / (image.inverse_radius**2 * UNIT_LENGTH_MM)
    return jacobian


@compiled
def predict_ball_image(fit: BallFit, p: Floats) -> tuple[Floats, Floats]:
    """Return the predicted raw pixels (2,) of a point p (3,) mm and their covariance (2, 2) px²."""
    image, point = project_ball(fit, p), np.empty(2)
    sensitivity, S_x = np.empty((2, 4)), multiply_vector(fit.S_inverse, image.x)
    for k in range(2):
        point[k] = fit.origin[3 + k] + image.m[k]
        copy_into(sensitivity[k], multiply_vector(fit.sums[1 + k], S_x))
        for i in range(4):
            sensitivity[k, i] -= image.m[k] * image.x[i]
    cov, scale = np.empty((2, 2)), fit.noise_variance / image.inverse_radius**2
    for k in range(2):
        inverse_column = multiply_vector(fit.c_inverse, sensitivity[k])
        for n in range(2):
            leverage = dot(image.x, S_x) if k == n else 0.0
            cov[k, n] = scale * (leverage + dot(sensitivity[n], inverse_column))
    return point, cov
