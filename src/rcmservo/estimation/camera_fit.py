"""Recursive fit of the camera's projection to all frames: the paper's (17)-(21) about any origin.

The model projects a point p mm to the pixels

    m = (A x̄) / (1 + gᵀx),    x = (p − p₀) / 100 mm,    x̄ = [x 1],    m in px from m₀

p₀ is the middle of both markers in the first frame, and m₀ the middle of their pixels. With this
origin the RCM may lie in front of the camera, in its focal plane or behind it, while eq. (10) needs
it in front. A and g are fitted to both markers in all frames. Each row of eq. (18) has the weight
w = 1/ẑ² with the estimated depth ẑ = 1 + gᵀx, which turns its error into pixels. With m = (u, v),
four sums suffice,

    S = Σ w x̄x̄ᵀ,   U = Σ w u x̄x̄ᵀ,   V = Σ w v x̄x̄ᵀ,   W = Σ w (u² + v²) x̄x̄ᵀ

since for h = [g 1] the rows of A are S⁻¹U h and S⁻¹V h, and their sum of squared residuals is hᵀQh
with Q = W − U S⁻¹U − V S⁻¹V. Noise σ of the pixels adds 2σ²S to W, which biases g towards zero; g
therefore minimises hᵀ(Q − 2σ²S)h. This is the steady state of rule (21), with all frames as
observations. It is the direct linear transformation of Abdel-Aziz and Karara (1971), with the
correction for errors in variables.

The offset of a marker is its mean residual over the newest frames nearby. Fit plus offset gives the
markers without their noise.
"""

from typing import NamedTuple

import numpy as np

from rcmservo.geometry.kinematics import Point
from rcmservo.geometry.tool import ToolStruct, compute_second_marker, compute_second_marker_tuple
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_distance, copy_into, fill
from rcmservo.numerics.small_solvers import invert
from rcmservo.numerics.structs import Row, part, real, reals

UNIT_LENGTH_MM = 100.0
"""Length of one unit of x in mm."""

PARAMETER_COUNT = 11.0
"""Number of parameters of the projection, A and g."""

MIN_WEIGHT_DEPTH = 0.2
"""Smallest relative depth ẑ that enters a weight."""

MIN_FRAME_SPACING_MM = 0.3
"""Smallest distance of marker 1 (mm) between two frames in the sums.

One position that is observed for long must not outweigh the others.
"""

OFFSET_DECAY_MM = 40.0
"""Path (mm) over which the weight of the offset decays to 1/e."""

MAX_OFFSET_FRAMES = 300.0
"""Largest number of frames in the mean of the offset."""

PRIOR_NOISE_PX = 0.5
"""Expected noise (px) before the frames determine it."""

PRIOR_NOISE_FRAMES = 5.0
"""Weight of the expected noise, as a number of frames."""

MAX_RESIDUAL_GROWTH = 1.2
"""Largest factor by which the noise correction may increase the sum of squared residuals."""

RCM_POSITION_MM = np.zeros(3)
"""Position of the RCM in mm."""

PRIOR_PRECISION = 1e-6, 1.0
"""Prior precision 1/variance of A (px) and of g."""


class FitWorkspace(Row):
    """Intermediate results of the fit, a part of the state so that the fit allocates no memory."""

    x: Floats = reals(4, "", "x̄ of a marker")
    m: Floats = reals(2, "px", "pixels of the marker, from m₀")
    Q: Floats = reals((4, 4), "", "W − U S⁻¹U − V S⁻¹V")
    column: Floats = reals(4, "", "a column of S⁻¹U or S⁻¹V; U h or V h")
    h: Floats = reals(4, "", "[g 1]")
    C: Floats = reals((3, 3), "", "inverse of the part of g in Q − 2σ²S, not yet accepted")


class ProjectionFit(Row):
    """Fit of the camera's projection: the sums over the frames and the solution."""

    sums: Floats = reals((4, 4, 4), "", "S, U, V, W")
    frame_count: float = real("", "number of frames in the sums; with a single marker 0.5")
    marker_sums: Floats = reals((2, 6), "", "Σ w [x u v 1] of each marker alone")
    origin: Floats = reals(5, "mm, px", "p₀ and m₀, NaN before the first frame")
    A: Floats = reals((2, 4), "px", "numerators")
    g: Floats = reals(3, "", "denominator")
    noise_variance: float = real("px²", "σ² by the residuals of the fit")
    S_inverse: Floats = reals((4, 4), "", "S⁻¹")
    g_inverse: Floats = reals(
        (3, 3), "", "inverse of the part of g in Q − 2σ²S; × σ², its covariance"
    )
    newest_summed_p1: Floats = reals(3, "mm", "p₁ of the newest frame in the sums")
    offset: Floats = reals((2, 2), "px", "mean residual of each marker")
    offset_weight: Floats = reals(2, "", "number of frames in the offset of each marker")
    newest_p1: Floats = reals(3, "mm", "p₁ of the newest frame")
    marker_weights: Floats = reals(2, "", "weight of each marker in the newest frame, 0 to 1")
    work: FitWorkspace = part(FitWorkspace, "intermediate results of the newest fit")


class ProjectedPoint(NamedTuple):
    """Predicted image of a point.

    Parameters
    ----------
    x : tuple[float, float, float, float]
        x̄.
    m : tuple[float, float]
        Pixels from m₀.
    z : float
        Relative depth ẑ, in units of the depth of p₀.
    """

    x: tuple[float, float, float, float]
    m: tuple[float, float]
    z: float


def make_initial_fit() -> ProjectionFit:
    """Return the fit before the first frame."""
    return ProjectionFit.of(origin=np.nan, noise_variance=PRIOR_NOISE_PX**2, marker_weights=1.0)


@compiled
def reset_fit(fit: ProjectionFit) -> None:
    """Reset the fit to its state before the first frame."""
    fill(fit.sums, 0.0)
    fill(fit.marker_sums, 0.0)
    fill(fit.origin, np.nan)
    fill(fit.A, 0.0)
    fill(fit.g, 0.0)
    fill(fit.S_inverse, 0.0)
    fill(fit.g_inverse, 0.0)
    fill(fit.newest_summed_p1, 0.0)
    fill(fit.offset, 0.0)
    fill(fit.offset_weight, 0.0)
    fill(fit.newest_p1, 0.0)
    fill(fit.marker_weights, 1.0)
    fill(fit.work.x, 0.0)
    fill(fit.work.m, 0.0)
    fill(fit.work.Q, 0.0)
    fill(fit.work.column, 0.0)
    fill(fit.work.h, 0.0)
    fill(fit.work.C, 0.0)
    fit.frame_count, fit.noise_variance = 0.0, PRIOR_NOISE_PX**2


@compiled
def update_fit(fit: ProjectionFit, p1: Floats, points: Floats, shaft: ToolStruct) -> None:
    """Update the fit by one frame with the raw `points` (2, 2) px and marker 1 at p1 (3,) mm.

    After the first frame either marker may be NaN. The markers count with `fit.marker_weights`.
    """
    is_first = not fit.frame_count > 0.0
    if is_first:
        set_origin(fit, p1, compute_second_marker(shaft, p1), points)
    if is_first or compute_distance(p1, fit.newest_summed_p1) >= MIN_FRAME_SPACING_MM:
        predictions = project_markers(fit, p1, shaft)
        for k in range(2):
            add_marker(fit, k, predictions[k], points)
        solve_fit(fit)
        copy_into(fit.newest_summed_p1, p1)
    decay = 0.0 if is_first else np.exp(-compute_distance(p1, fit.newest_p1) / OFFSET_DECAY_MM)
    predictions = project_markers(fit, p1, shaft)
    for k in range(2):
        update_offset(fit, k, predictions[k], points[k], decay)
    copy_into(fit.newest_p1, p1)


@compiled
def set_origin(fit: ProjectionFit, p1: Floats, p2: Floats, points: Floats) -> None:
    """Set p₀ and m₀ to the middle of both markers in the first frame."""
    for i in range(3):
        fit.origin[i] = 0.5 * (p1[i] + p2[i])
    for i in range(2):
        fit.origin[3 + i] = 0.5 * (points[0, i] + points[1, i])


@compiled
def project_point(fit: ProjectionFit, p: Floats | Point) -> ProjectedPoint:
    """Return the predicted image m = A x̄ / (1 + gᵀx) of a point p (3,) mm."""
    A, g, origin = fit.A, fit.g, fit.origin
    x_0 = (p[0] - origin[0]) / UNIT_LENGTH_MM
    x_1 = (p[1] - origin[1]) / UNIT_LENGTH_MM
    x_2 = (p[2] - origin[2]) / UNIT_LENGTH_MM
    z = 1.0 + g[0] * x_0 + g[1] * x_1 + g[2] * x_2
    u_z = A[0, 0] * x_0 + A[0, 1] * x_1 + A[0, 2] * x_2 + A[0, 3]
    v_z = A[1, 0] * x_0 + A[1, 1] * x_1 + A[1, 2] * x_2 + A[1, 3]
    return ProjectedPoint((x_0, x_1, x_2, 1.0), (u_z / z, v_z / z), z)


@compiled
def project_markers(
    fit: ProjectionFit, p1: Floats | Point, shaft: ToolStruct
) -> tuple[ProjectedPoint, ProjectedPoint]:
    """Return the predicted images of both markers with marker 1 at p1 (3,) mm."""
    return project_point(fit, p1), project_point(fit, compute_second_marker_tuple(shaft, p1))


@compiled
def add_marker(fit: ProjectionFit, k: int, prediction: ProjectedPoint, points: Floats) -> None:
    """Add marker k with the raw `points` (2, 2) px to the sums, unless it is lost."""
    if not all_finite(points[k]):
        return
    fit.frame_count += 0.5 * fit.marker_weights[k]
    x, m = fit.work.x, fit.work.m
    weight = fit.marker_weights[k] / max(prediction.z, MIN_WEIGHT_DEPTH) ** 2
    x[0], x[1], x[2], x[3] = prediction.x
    for i in range(2):
        m[i] = points[k, i] - fit.origin[3 + i]
    add_to_sums(fit, x, m, weight)
    for i in range(3):
        fit.marker_sums[k, i] += weight * x[i]
    for i in range(2):
        fit.marker_sums[k, 3 + i] += weight * m[i]
    fit.marker_sums[k, 5] += weight


@compiled
def add_to_sums(fit: ProjectionFit, x: Floats, m: Floats, weight: float) -> None:
    """Add one point with x̄ (4,) and m (2,) px from m₀ to S, U, V and W."""
    squared_radius = m[0] * m[0] + m[1] * m[1]
    for i in range(4):
        for j in range(4):
            product = weight * x[i] * x[j]
            fit.sums[0, i, j] += product
            fit.sums[1, i, j] += product * m[0]
            fit.sums[2, i, j] += product * m[1]
            fit.sums[3, i, j] += product * squared_radius


@compiled
def write_residual_form(fit: ProjectionFit, Q: Floats) -> None:
    """Write Q = W − U S⁻¹U − V S⁻¹V (4, 4); hᵀQh is the sum of squared residuals."""
    copy_into(Q, fit.sums[3])
    column = fit.work.column
    for k in range(1, 3):
        for j in range(4):
            write_product(fit.S_inverse, fit.sums[k, :, j], column)
            for i in range(4):
                entry = Q[i, j]
                for n in range(4):
                    entry -= fit.sums[k, i, n] * column[n]
                Q[i, j] = entry


@compiled
def write_product(M: Floats, x: Floats, product: Floats) -> None:
    """Write M x (4,) of M (4, 4) and x (4,) into `product`, without allocating memory."""
    for i in range(4):
        total = 0.0
        for j in range(4):
            total += M[i, j] * x[j]
        product[i] = total


@compiled
def solve_denominator(
    fit: ProjectionFit, Q: Floats, correction: float, h: Floats, C: Floats
) -> bool:
    """Write h = [g 1] (4,) and the inverse C (3, 3) that g is solved with; return whether C exists.

    Q is reduced by `correction` times S.
    """
    for i in range(3):
        for j in range(3):
            C[i, j] = Q[i, j] - correction * fit.sums[0, i, j]
        C[i, i] += PRIOR_PRECISION[1] * fit.noise_variance
    is_invertible = invert(C)
    h[3] = 1.0
    for i in range(3):
        total = 0.0
        for j in range(3):
            total -= C[i, j] * (Q[j, 3] - correction * fit.sums[0, j, 3])
        h[i] = total
    return is_invertible


@compiled
def evaluate_quadratic_form(M: Floats, h: Floats) -> float:
    """Return hᵀMh of M (4, 4) and h (4,)."""
    total = 0.0
    for i in range(4):
        for j in range(4):
            total += h[i] * M[i, j] * h[j]
    return total


@compiled
def solve_fit(fit: ProjectionFit) -> None:
    """Solve for A, g and σ² from the sums.

    The correction 2σ² of Q is estimated from the residuals of an uncorrected solution. It is
    applied only if it hardly increases these residuals: a motion too short to determine g must not
    make g large.
    """
    copy_into(fit.S_inverse, fit.sums[0])
    for i in range(4):
        fit.S_inverse[i, i] += PRIOR_PRECISION[0] * fit.noise_variance
    invert(fit.S_inverse)
    point_count, Q, h, C = 2.0 * fit.frame_count, fit.work.Q, fit.work.h, fit.work.C
    write_residual_form(fit, Q)
    solve_denominator(fit, Q, 0.0, h, fit.g_inverse)
    residual = max(evaluate_quadratic_form(Q, h), 0.0)
    copy_into(fit.g, h[:3])
    # each row of A has four parameters, which reduce the residuals
    unexplained_fraction = max(1.0 - 4.0 / point_count, 0.0)
    correction = residual / evaluate_quadratic_form(fit.sums[0], h) * unexplained_fraction
    is_solved = solve_denominator(fit, Q, correction, h, C)
    corrected_residual = evaluate_quadratic_form(Q, h)
    if is_solved and corrected_residual <= MAX_RESIDUAL_GROWTH * residual:
        residual = corrected_residual
        copy_into(fit.g, h[:3])
        copy_into(fit.g_inverse, C)
    copy_into(h[:3], fit.g)
    for k in range(2):
        write_product(fit.sums[k + 1], h, fit.work.column)
        write_product(fit.S_inverse, fit.work.column, fit.A[k])
    prior_rows = 4.0 * PRIOR_NOISE_FRAMES
    free_rows = max(2.0 * point_count - PARAMETER_COUNT, 0.0)
    prior_residual = prior_rows * PRIOR_NOISE_PX**2
    fit.noise_variance = (max(residual, 0.0) + prior_residual) / (free_rows + prior_rows)


@compiled
def update_offset(
    fit: ProjectionFit, k: int, prediction: ProjectedPoint, point: Floats, decay: float
) -> None:
    """Update the offset of marker k by its newest residual.

    The weight of earlier residuals decays by the factor `decay`. `point` (2,) px is the raw
    marker; while it is lost, the offset decays by the same factor.
    """
    fit.offset_weight[k] *= decay
    if not all_finite(point):
        fit.offset[k, 0], fit.offset[k, 1] = decay * fit.offset[k, 0], decay * fit.offset[k, 1]
        return
    fit.offset_weight[k] = min(fit.offset_weight[k] + 1.0, MAX_OFFSET_FRAMES)
    for i in range(2):
        change = point[i] - fit.origin[3 + i] - prediction.m[i] - fit.offset[k, i]
        fit.offset[k, i] += fit.marker_weights[k] * change / fit.offset_weight[k]
