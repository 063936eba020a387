"""Joint paths from a start to a target: straight lines and paths of the saturated law."""

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
from rcmservo.sim.ground_truth import compute_feature_jacobian
from rcmservo.sim.tool_body import ToolBody

PATH_POINTS = 9
"""Points of a path at which a scene is tested."""


def plan_straight_path(body: ToolBody, start: Floats, target: Floats) -> Floats:
    """Return joints (PATH_POINTS, 3) on the straight line of the reference point to the target."""
    return interpolate_straight_path(body.mechanism.to_struct(), start, target)


@compiled
def interpolate_straight_path(rcm: RcmStruct, start: Floats, target: Floats) -> Floats:
    """Compute `plan_straight_path` of the mechanism's own reference point."""
    a, b = compute_position(rcm, start), compute_position(rcm, target)
    path, p = np.empty((PATH_POINTS, 3)), np.empty(3)
    for i in range(PATH_POINTS):
        fraction = i / (PATH_POINTS - 1)
        for k in range(3):
            p[k] = a[k] + fraction * (b[k] - a[k])
        copy_into(path[i], compute_joints(rcm, p))
    return path


def plan_saturated_path(
    body: ToolBody, optics: CameraModel, target: Floats, errors: Floats
) -> tuple[Floats, Floats] | None:
    """Return joints (PATH_POINTS, 3) on the path of the saturated law (33) from Δy = `errors`.

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
    largest = np.max(np.abs(errors) / FEATURE_SCALE)
    for fraction in np.linspace(1.0, 0.0, PATH_POINTS)[1:]:
        remaining = np.sign(errors) * np.maximum(
            np.abs(errors) - fraction * largest * FEATURE_SCALE, 0.0
        )
        q = _solve_for_error(body, optics, path[-1], y_d, remaining)
        if q is None:
            return None
        path.append(q)
    half_way = _solve_for_error(body, optics, path[PATH_POINTS // 2], y_d, 0.5 * errors)
    return None if half_way is None else (np.stack(path[::-1]), half_way)


def _solve_for_error(
    body: ToolBody, optics: CameraModel, q: Floats, y_d: Floats, error: Floats
) -> Floats | None:
    """Return joints (3,) at which y − y_d is `error`, by Newton's method from q.

    None if the method does not converge.
    """
    for _ in range(10):
        residual = compute_feature_error(
            error, compute_feature_error(compute_true_features(body, optics, q), y_d)
        )
        if np.max(np.abs(residual) / FEATURE_SCALE) < 1e-9:
            return q
        J = scale_rows(compute_feature_jacobian(body, optics, q, compute_imaged_rcm(optics)))
        if not (np.isfinite(J).all() and np.linalg.cond(J) < 1e6):
            return None
        p1: Floats = body.points(q)[0] + np.linalg.solve(J, residual / FEATURE_SCALE)
        solution = body.mechanism.joints(p1 * (1.0 - body.tool.offset / np.linalg.norm(p1)))
        solution[:2] += 2.0 * np.pi * np.round((q[:2] - solution[:2]) / (2.0 * np.pi))
        q = solution
    return None


def compute_true_features(body: ToolBody, optics: CameraModel, q: Floats) -> Floats:
    """Return y (3,) about the true imaged RCM at the joints q (3,)."""
    return compute_features(
        shift_to_rcm(optics.project(body.points(q)[:2]), compute_imaged_rcm(optics))
    )


def compute_imaged_rcm(optics: CameraModel) -> Floats:
    """Return the true o_c (2,) px, NaN where the lens model does not reach."""
    return optics.project(np.zeros((1, 3)))[0]
