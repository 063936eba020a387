"""Choice of the next exploration corner, and the test that the direction to the target is known.

The projection fit (camera_fit.py) has eleven parameters θ, the rows of A and g. With D = ∂m/∂θ (4,
11) of both markers at a position, frames at many positions determine θ with the covariance

    σ² N⁻¹,    N = Σ DᵀD + N₀

N is the information of the frames, and N₀ that of the prior. The path to the target is H⁺(m_d − m)
with H = ∂m/∂p₁. An error δθ of the fit changes it by T δθ, T = H⁺(D(p₁ + path) − D(p₁)), so that
its expected error is σ √tr(T N⁻¹Tᵀ). On a long path the error of its first LOOK_AHEAD_MM is
extrapolated in proportion, as the estimate improves during the motion.

A leg from p to p' adds to N the information of its frames, by Simpson's rule. The next corner
minimises the expected error. The candidates are the corners of the round's box about the start and
the points between them, inside the joint limits and not too far away.
"""

import numpy as np

from rcmservo.control.exploration import LIMIT_MARGIN, Exploration, ExplorationState, is_at_corner
from rcmservo.estimation.camera_fit import (
    MIN_WEIGHT_DEPTH,
    PRIOR_PRECISION,
    ProjectedPoint,
    ProjectionFit,
    project_markers,
)
from rcmservo.estimation.camera_fit_prediction import invert_normal_matrix, write_markers_jacobian
from rcmservo.geometry.kinematics import (
    Point,
    RcmStruct,
    compute_point_distance,
    compute_position_tuple,
)
from rcmservo.geometry.tool import ToolStruct
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm, copy_into, fill
from rcmservo.numerics.small_solvers import invert

LOOK_AHEAD_MM = 10.0
"""Largest part (mm) of the path over which its error is computed; the rest is extrapolated."""

NEGLIGIBLE_ERROR_MM = 0.5
"""Error (mm) of the path that is accepted for any length of the path."""

CANDIDATE_CORNERS = 27
"""Number of candidate corners: each joint at the start, or one side of the box up or down."""


@compiled
def write_theta_jacobian(prediction: ProjectedPoint, D: Floats) -> None:
    """Write ∂m/∂θ (2, 11) of a point with the given prediction."""
    fill(D, 0.0)
    for k in range(2):
        for i in range(4):
            D[k, 4 * k + i] = prediction.x[i] / prediction.z
        for i in range(3):
            D[k, 8 + i] = -prediction.m[k] * prediction.x[i] / prediction.z


@compiled
def write_theta_jacobians(fit: ProjectionFit, p1: Point, shaft: ToolStruct, D: Floats) -> bool:
    """Write ∂m/∂θ (4, 11) of both markers with marker 1 at p1 (3,) mm.

    Return whether the fit has both markers in front of the camera.
    """
    image_1, image_2 = project_markers(fit, p1, shaft)
    write_theta_jacobian(image_1, D[:2])
    write_theta_jacobian(image_2, D[2:])
    return image_1.z > MIN_WEIGHT_DEPTH and image_2.z > MIN_WEIGHT_DEPTH


@compiled
def write_information(fit: ProjectionFit, N: Floats) -> None:
    """Write N (11, 11) of the frames so far and the prior."""
    fill(N, 0.0)
    for k in range(2):
        for i in range(4):
            for j in range(4):
                N[4 * k + i, 4 * k + j] = fit.sums[0, i, j]
            for j in range(3):
                N[4 * k + i, 8 + j] = -fit.sums[1 + k, i, j]
                N[8 + j, 4 * k + i] = -fit.sums[1 + k, i, j]
            N[4 * k + i, 4 * k + i] += PRIOR_PRECISION[0] * fit.noise_variance
    for i in range(3):
        for j in range(3):
            N[8 + i, 8 + j] = fit.sums[3, i, j]
        N[8 + i, 8 + i] += PRIOR_PRECISION[1] * fit.noise_variance


@compiled
def add_leg_information(
    fit: ProjectionFit, start: Point, end: Point, frames: float, shaft: ToolStruct, N: Floats
) -> None:
    """Add to N (11, 11) the information of `frames` frames on a straight leg of marker 1.

    The leg runs from `start` to `end`, both in mm.
    """
    D = np.empty((4, 11))
    for k in range(3):
        fraction = 0.5 * k
        x, y, z = end[0] - start[0], end[1] - start[1], end[2] - start[2]
        point = start[0] + fraction * x, start[1] + fraction * y, start[2] + fraction * z
        write_theta_jacobians(fit, point, shaft, D)
        weight = frames * (4.0 if k == 1 else 1.0) / 6.0
        for n in range(4):
            for i in range(11):
                for j in range(11):
                    N[i, j] += weight * D[n, i] * D[n, j]


@compiled
def write_path_sensitivity(
    fit: ProjectionFit, p1: Point, target: Floats, shaft: ToolStruct, T: Floats
) -> float:
    """Write T (3, 11) of the path to the target; return the length of the path in mm.

    T is in mm per unit of θ. The path runs from marker 1 at p1 (3,) mm to the `target` (2, 2) raw
    px. Its length is infinite if the fit does not determine it.
    """
    H, inverse, D = np.empty((4, 3)), np.empty((3, 3)), np.empty((4, 11))
    D_ahead, path, H_pinv = np.empty((4, 11)), np.empty(3), np.empty((3, 4))
    write_markers_jacobian(fit, p1, shaft, H)
    if not invert_normal_matrix(H, inverse):
        return np.inf
    image_1, image_2 = project_markers(fit, p1, shaft)
    fill(path, 0.0)
    for i in range(3):
        row = inverse[i]
        for n in range(4):
            H_pinv[i, n] = row[0] * H[n, 0] + row[1] * H[n, 1] + row[2] * H[n, 2]
        for j in range(2):
            marker_1 = fit.origin[3 + j] + image_1.m[j] + fit.offset[0, j]
            marker_2 = fit.origin[3 + j] + image_2.m[j] + fit.offset[1, j]
            path[i] += H_pinv[i, j] * (target[0, j] - marker_1)
            path[i] += H_pinv[i, 2 + j] * (target[1, j] - marker_2)
    distance = compute_norm(path)
    fraction = LOOK_AHEAD_MM / distance if distance > LOOK_AHEAD_MM else 1.0
    ahead = p1[0] + fraction * path[0], p1[1] + fraction * path[1], p1[2] + fraction * path[2]
    is_visible = write_theta_jacobians(fit, p1, shaft, D)
    if not (is_visible and write_theta_jacobians(fit, ahead, shaft, D_ahead)):
        return np.inf
    for i in range(3):
        for j in range(11):
            T[i, j] = 0.0
            for n in range(4):
                T[i, j] += H_pinv[i, n] * (D_ahead[n, j] - D[n, j]) / fraction
    return distance


@compiled
def compute_expected_error(T: Floats, N: Floats, noise_variance: float) -> float:
    """Return σ √tr(T N⁻¹Tᵀ) mm of T (3, 11), N (11, 11), σ² px²; infinite if N is singular."""
    inverse, total = np.empty((11, 11)), 0.0
    copy_into(inverse, N)
    if not invert(inverse):
        return np.inf
    for k in range(3):
        for i in range(11):
            for j in range(11):
                total += T[k, i] * inverse[i, j] * T[k, j]
    return np.sqrt(noise_variance * total)


@compiled
def compute_path_error(
    fit: ProjectionFit, p1: Floats, target: Floats, shaft: ToolStruct
) -> tuple[float, float]:
    """Return the standard deviation of the error and the length of the path to the target, in mm.

    The path runs from marker 1 at p1 (3,) mm to the `target` (2, 2) raw px. Both are infinite if
    the fit does not determine it.
    """
    T, N = np.empty((3, 11)), np.empty((11, 11))
    distance = write_path_sensitivity(fit, (p1[0], p1[1], p1[2]), target, shaft, T)
    if not distance < np.inf:
        return np.inf, np.inf
    write_information(fit, N)
    return compute_expected_error(T, N, fit.noise_variance), distance


@compiled
def direction_is_known(
    fit: ProjectionFit, p1: Floats, target: Floats, shaft: ToolStruct, settings: Exploration
) -> bool:
    """Return whether the direction from marker 1 at p1 (3,) mm to the target is known.

    It is known if the expected error of the path to the `target` (2, 2) raw px is at most the
    fraction `settings.uncertainty` of its length, or negligible.
    """
    error, distance = compute_path_error(fit, p1, target, shaft)
    return error < np.inf and error <= max(settings.uncertainty * distance, NEGLIGIBLE_ERROR_MM)


@compiled
def write_candidate(state: ExplorationState, index: int, rcm: RcmStruct, q: Floats) -> bool:
    """Write the joints q (3,) of a candidate corner; return whether the joint limits allow it."""
    for i in range(3):
        step, margin = index % 3 - 1, LIMIT_MARGIN * (rcm.upper[i] - rcm.lower[i])
        index //= 3
        q[i] = state.start_joints[i] + step * state.sides[i]
        if step != 0 and not rcm.lower[i] + margin <= q[i] <= rcm.upper[i] - margin:
            return False
    return True


@compiled
def plan_corner(
    state: ExplorationState,
    fit: ProjectionFit,
    rcm: RcmStruct,
    shaft: ToolStruct,
    q: Floats,
    target: Floats,
    max_distance: float,
) -> None:
    """Set the next corner to the candidate with the least expected error of the path to the target.

    The path starts at the joints q (3,) and ends at the `target` (2, 2) raw px. Candidates are at
    most `max_distance` mm away. Without a usable candidate the corner stays.
    """
    T, N, N_after = np.empty((3, 11)), np.empty((11, 11)), np.empty((11, 11))
    p1, corner, least_error = compute_position_tuple(rcm, q), np.empty(3), np.inf
    if not write_path_sensitivity(fit, p1, target, shaft, T) < np.inf:
        return
    write_information(fit, N)
    frames_per_leg = fit.frame_count / state.visited_corners
    for index in range(CANDIDATE_CORNERS):
        if not write_candidate(state, index, rcm, corner) or is_at_corner(state, corner, q):
            continue
        end = compute_position_tuple(rcm, corner)
        if compute_point_distance(p1, end) <= max_distance:
            copy_into(N_after, N)
            add_leg_information(fit, p1, end, frames_per_leg, shaft, N_after)
            error = compute_expected_error(T, N_after, fit.noise_variance)
            if error < least_error:
                least_error = error
                copy_into(state.next_corner, corner)
