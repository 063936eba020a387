"""Joint paths from a start to a target: straight lines, and paths of the saturated controller."""

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.geometry.features import (
    FEATURE_SCALE,
    compute_feature_error,
    compute_features,
    shift_to_rcm,
)
from rcmservo.geometry.kinematics import RcmStruct, compute_joints, compute_position
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.ground_truth import compute_true_jacobian_at_joints
from rcmservo.sim.tool_body import ToolBody

PATH_POINTS = 9
"""Number of points of a path at which a scene is tested."""

MAX_NEWTON_STEPS = 10
"""Newton steps after which no solution is expected."""

RESIDUAL_TOLERANCE = 1e-9
"""Residual, in units of `FEATURE_SCALE`, at which Newton's method has converged."""

MAX_NEWTON_CONDITION = 1e6
"""Largest condition number of the scaled Jacobian at which a Newton step is taken."""


def plan_straight_path(body: ToolBody, start: Floats, target: Floats) -> Floats:
    """Return joints (PATH_POINTS, 3) along which the tool's reference point moves straight."""
    return interpolate_straight_path(body.mechanism.to_struct(), start, target)


@compiled
def interpolate_straight_path(rcm: RcmStruct, start: Floats, target: Floats) -> Floats:
    """Compute `plan_straight_path` for the reference point of `rcm`."""
    p_start, p_target = compute_position(rcm, start), compute_position(rcm, target)
    path, p = np.empty((PATH_POINTS, 3)), np.empty(3)
    for i in range(PATH_POINTS):
        fraction = i / (PATH_POINTS - 1)
        for k in range(3):
            p[k] = p_start[k] + fraction * (p_target[k] - p_start[k])
        copy_into(path[i], compute_joints(rcm, p))
    return path


def plan_saturated_path(
    body: ToolBody, optics: CameraModel, target: Floats, errors: Floats
) -> tuple[Floats, Floats] | None:
    """Return joints (PATH_POINTS, 3) on the path of the saturated controller from Δy = `errors`.

    By eq. (33) all errors shrink at the same rate, in units of `FEATURE_SCALE`, until each is zero.

    Parameters
    ----------
    body : ToolBody
        Tool.
    optics : CameraModel
        True camera.
    target : Floats, shape (3,)
        Joints of the target.
    errors : Floats, shape (3,)
        Initial error (rad, px, px).

    Returns
    -------
    tuple or None
        Joints of the path, and the joints (3,) at half the error; None if no such joints exist.
    """
    y_d = compute_true_features(body, optics, target)
    path = [target]
    largest_error = np.max(np.abs(errors) / FEATURE_SCALE)
    for fraction in np.linspace(1.0, 0.0, PATH_POINTS)[1:]:
        reduction = fraction * largest_error * FEATURE_SCALE
        remaining_errors = np.sign(errors) * np.maximum(np.abs(errors) - reduction, 0.0)
        q = _solve_for_error(body, optics, path[-1], y_d, remaining_errors)
        if q is None:
            return None
        path.append(q)
    midpoint = _solve_for_error(body, optics, path[PATH_POINTS // 2], y_d, 0.5 * errors)
    return None if midpoint is None else (np.stack(path[::-1]), midpoint)


def _solve_for_error(
    body: ToolBody, optics: CameraModel, q: Floats, y_d: Floats, error: Floats
) -> Floats | None:
    """Return joints (3,) at which y − y_d is `error`, by Newton's method from q.

    None if the method does not converge.
    """
    for _ in range(MAX_NEWTON_STEPS):
        present_error = compute_feature_error(compute_true_features(body, optics, q), y_d)
        residual = compute_feature_error(error, present_error)
        if np.max(np.abs(residual) / FEATURE_SCALE) < RESIDUAL_TOLERANCE:
            return q
        J = scale_rows(compute_true_jacobian_at_joints(body, optics, q, compute_imaged_rcm(optics)))
        if not (np.isfinite(J).all() and np.linalg.cond(J) < MAX_NEWTON_CONDITION):
            return None
        p1: Floats = body.points(q)[0] + np.linalg.solve(J, residual / FEATURE_SCALE)
        solution = body.mechanism.joints(p1 * (1.0 - body.tool.offset / np.linalg.norm(p1)))
        solution[:2] += 2.0 * np.pi * np.round((q[:2] - solution[:2]) / (2.0 * np.pi))
        q = solution
    return None


def compute_true_features(body: ToolBody, optics: CameraModel, q: Floats) -> Floats:
    """Return y (3,) about the true imaged RCM at the joints q (3,)."""
    m = optics.project(body.points(q)[:2])
    return compute_features(shift_to_rcm(m, compute_imaged_rcm(optics)))


def compute_imaged_rcm(optics: CameraModel) -> Floats:
    """Return the true image o_c (2,) px of the RCM, NaN where the lens model does not reach."""
    return optics.project(np.zeros((1, 3)))[0]
