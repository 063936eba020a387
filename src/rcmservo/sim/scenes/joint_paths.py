"""Ways of the joints from a start to a target."""

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import put
from rcmservo.method.controller import scaled
from rcmservo.method.features import SCALE, about, difference, features
from rcmservo.method.kinematics import Rcm, joints, position
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.ground_truth import feature_jacobian
from rcmservo.sim.tool_body import Body

WAY = 9
"""Places on the way from start to target at which a scene is judged."""


def straight(body: Body, start: Floats, target: Floats) -> Floats:
    """Joints (WAY, 3) that take the tool's reference point from start to target in a straight
    line."""
    return straight_way(body.mechanism.rcm(), start, target)


@compiled
def straight_way(rcm: Rcm, start: Floats, target: Floats) -> Floats:
    """`straight`, of the mechanism and its reference point."""
    a, b = position(rcm, start), position(rcm, target)
    way, p = np.empty((WAY, 3)), np.empty(3)
    for i in range(WAY):
        share = i / (WAY - 1)
        for k in range(3):
            p[k] = a[k] + share * (b[k] - a[k])
        put(way[i], joints(rcm, p))
    return way


def with_errors(
    body: Body, optics: Optics, target: Floats, errors: Floats
) -> tuple[Floats, Floats] | None:
    """Joints (WAY, 3) on the way of the saturated law (33) from Δy = `errors` (rad, px, px), and
    the joints where half of them is left. None where there are no such joints."""
    y_d = features_at(body, optics, target)
    way = [target]
    longest = np.max(np.abs(errors) / SCALE)
    for share in np.linspace(1.0, 0.0, WAY)[1:]:
        left = np.sign(errors) * np.maximum(np.abs(errors) - share * longest * SCALE, 0.0)
        q = _with_error(body, optics, way[-1], y_d, left)
        if q is None:
            return None
        way.append(q)
    half_way = _with_error(body, optics, way[WAY // 2], y_d, 0.5 * errors)
    return None if half_way is None else (np.stack(way[::-1]), half_way)


def _with_error(body: Body, optics: Optics, q: Floats, y_d: Floats, error: Floats) -> Floats | None:
    """Joints (3,) at which y − y_d is `error`, by Newton's method from q. None where it finds
    none."""
    for _ in range(10):
        left = difference(error, difference(features_at(body, optics, q), y_d))
        if np.max(np.abs(left) / SCALE) < 1e-9:
            return q
        J = scaled(feature_jacobian(body, optics, q, imaged_rcm(optics)))
        if not (np.isfinite(J).all() and np.linalg.cond(J) < 1e6):
            return None
        p1: Floats = body.points(q)[0] + np.linalg.solve(J, left / SCALE)
        near = body.mechanism.joints(p1 * (1.0 - body.tool.offset / np.linalg.norm(p1)))
        near[:2] += 2.0 * np.pi * np.round((q[:2] - near[:2]) / (2.0 * np.pi))
        q = near
    return None


def features_at(body: Body, optics: Optics, q: Floats) -> Floats:
    """y (3,) about the true imaged RCM at the joints q (3,)."""
    return features(about(optics.project(body.points(q)[:2]), imaged_rcm(optics)))


def imaged_rcm(optics: Optics) -> Floats:
    """The true o_c, (2,) px; NaN where the lens model does not reach."""
    return optics.project(np.zeros((1, 3)))[0]
