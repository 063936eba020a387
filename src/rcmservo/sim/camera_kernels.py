"""Simulated camera for compiled functions: its parameters, projection and Jacobian, eq. (15).

`CameraModel` in camera_model.py is the same camera for Python code, and defines the lens model.
"""

import numpy as np

from rcmservo.geometry.features import compute_features_jacobian, shift_to_rcm
from rcmservo.geometry.kinematics import Point
from rcmservo.geometry.tool import (
    ToolStruct,
    compute_second_marker,
    compute_second_marker_jacobian,
    compute_second_marker_tuple,
)
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import copy_into, multiply_matrices
from rcmservo.numerics.structs import Row, real, reals, whole


class CameraStruct(Row):
    """Parameters of `CameraModel`."""

    width: int = whole("px", "width of the image")
    height: int = whole("px", "height of the image")
    focal: float = real("px", "focal length")
    centre: Floats = reals(2, "px", "principal point")
    distortion: Floats = reals(2, "", "k1 and k2")
    fold: float = real("", "slope beyond which the distortion polynomial decreases")
    rotation: Floats = reals((3, 3), "", "from world axes to camera axes")
    position: Floats = reals(3, "mm", "camera centre in the world")


@compiled
def transform_to_camera(camera: CameraStruct, p: Floats | Point) -> tuple[float, float, float]:
    """Return a world point p (3,) mm in camera axes; the third number is its depth."""
    R = camera.rotation
    x, y, z = p[0] - camera.position[0], p[1] - camera.position[1], p[2] - camera.position[2]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled
def project(camera: CameraStruct, p: Floats | Point) -> tuple[float, float]:
    """Return the image (u, v) px of a world point p (3,) mm.

    It is NaN where `CameraModel.project` returns NaN.
    """
    x, y, z = transform_to_camera(camera, p)
    u, v = x / z, y / z
    r2 = u * u + v * v
    if not (z > 0.0 and np.sqrt(r2) < camera.fold):
        return np.nan, np.nan
    scale = camera.focal * (1.0 + r2 * (camera.distortion[0] + r2 * camera.distortion[1]))
    return scale * u + camera.centre[0], scale * v + camera.centre[1]


@compiled
def project_jacobian(camera: CameraStruct, p: Floats) -> Floats:
    """Return the derivative (2, 3) px/mm of `project` at p (3,) mm."""
    x, y, z = transform_to_camera(camera, p)
    u, v = x / z, y / z
    r2 = u * u + v * v
    k1, k2 = camera.distortion[0], camera.distortion[1]
    stretch, growth = 1.0 + r2 * (k1 + r2 * k2), 2.0 * k1 + 4.0 * k2 * r2
    uu, uv, vv = stretch + growth * u * u, growth * u * v, stretch + growth * v * v
    out, scale, R = np.empty((2, 3)), camera.focal / z, camera.rotation
    for k in range(3):
        du, dv = R[0, k] - u * R[2, k], R[1, k] - v * R[2, k]
        out[0, k], out[1, k] = scale * (uu * du + uv * dv), scale * (uv * du + vv * dv)
    return out


@compiled
def project_markers(camera: CameraStruct, tool: ToolStruct, p1: Floats) -> Floats:
    """Return the images (2, 2) px of both markers, with marker 1 at p1 (3,) mm."""
    out = np.empty((2, 2))
    project_markers_into(camera, tool, (p1[0], p1[1], p1[2]), out)
    return out


@compiled
def project_markers_into(camera: CameraStruct, tool: ToolStruct, p1: Point, out: Floats) -> None:
    """Write the images of both markers into `out` (2, 2) px, with marker 1 at p1 (3,) mm."""
    out[0, 0], out[0, 1] = project(camera, p1)
    out[1, 0], out[1, 1] = project(camera, compute_second_marker_tuple(tool, p1))


@compiled
def compute_markers_jacobian(camera: CameraStruct, tool: ToolStruct, p1: Floats) -> Floats:
    """Return ∂(m₁, m₂)/∂p₁ (4, 3) px/mm, the second factor of eq. (15), through the true camera."""
    out = np.empty((4, 3))
    second = project_jacobian(camera, compute_second_marker(tool, p1))
    copy_into(out[:2], project_jacobian(camera, p1))
    copy_into(out[2:], multiply_matrices(second, compute_second_marker_jacobian(tool, p1)))
    return out


@compiled
def compute_true_jacobian(
    camera: CameraStruct, tool: ToolStruct, p1: Floats, o_c: Floats
) -> Floats:
    """Return J (3, 3) of eq. (15) with marker 1 at p1 (3,) mm, about the origin o_c (2,) px."""
    m = shift_to_rcm(project_markers(camera, tool, p1), o_c)
    markers_jacobian = compute_markers_jacobian(camera, tool, p1)
    return multiply_matrices(compute_features_jacobian(m), markers_jacobian)
