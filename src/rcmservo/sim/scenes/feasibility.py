"""Feasibility of a scene: joint limits, visible markers and the Jacobian's condition number."""

from dataclasses import dataclass

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.geometry.kinematics import RcmStruct, compute_position
from rcmservo.geometry.tool import ToolStruct, compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite, compute_distance
from rcmservo.numerics.small_svd import compute_condition
from rcmservo.numerics.structs import Rows
from rcmservo.sim.camera_kernels import (
    CameraStruct,
    compute_true_jacobian,
    project,
    project_markers,
    transform_to_camera,
)
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.scene import Scene, SceneSettings
from rcmservo.sim.tool_body import ToolBody

IMAGE_BORDER_PX = 12.0
"""Least distance (px) of the imaged balls from the image border."""

MIN_SEPARATION_RADII = 3.0
"""Least distance of the imaged markers, in radii of the larger one: neither hides the other."""

MIN_DEPTH_RADII = 5.0
"""Least depth of both balls in front of the camera, in radii of the larger ball."""

SILHOUETTE_MARGIN_RATIO = 1.2
"""Ratio of the assumed radius of an imaged ball to focal length times radius over depth. It covers
distortion and perspective."""

CUBE_CORNERS = np.array(
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
) / np.sqrt(3.0)
"""Half of the corners of a cube, at distance 1 from its centre; the others are opposite to them."""

JOINT_MARGIN_FRACTION = 0.03
"""Least distance of the path from a joint limit, as a fraction of the joint's range."""


@dataclass(frozen=True, eq=False)
class SceneFeasibility:
    """Test of whether a servo can start from a scene's start and reach its target.

    Parameters
    ----------
    settings : SceneSettings
        Distributions of the scenes.
    body : ToolBody
        Tool.
    radius : float
        Radius (mm) of the larger ball.
    """

    settings: SceneSettings

    body: ToolBody

    radius: float

    def is_feasible(self, scene: Scene) -> bool:
        """Return True if a scene is feasible.

        If the user gives both start and target, only the visibility of the markers counts.
        """
        optics, path, body, settings = scene.optics, scene.path, self.body, self.settings
        if settings.is_sampled and not path_is_within_limits(body.rcm, path):
            return False
        if not self.markers_visible(optics, np.vstack([path, scene.midpoint])):
            return False
        if not settings.is_sampled:
            return True
        explored = path[:1] if settings.errors is None else np.stack([path[0], scene.midpoint])
        room = float(settings.room)
        has_room = room_is_visible(optics.lens, body.rcm, body.tool.struct, explored, room)
        return has_room and self.is_well_conditioned(optics, path)

    def markers_visible(self, optics: CameraModel, path: Floats) -> bool:
        """Return True if both balls are whole and apart in the image along the path (n, 3)."""
        body = self.body
        return balls_are_whole_on_path(optics.lens, body.rcm, body.tool.struct, path, self.radius)

    def is_well_conditioned(self, optics: CameraModel, path: Floats) -> bool:
        """Return True if the scaled Jacobian is conditioned as required along the path (n, 3).

        Always True for an endoscope, which may not image the RCM: there is no Jacobian then.
        """
        if self.settings.ports is not None:
            return True
        body, settings = self.body, self.settings
        highest, lowest = float(settings.max_condition), float(settings.min_condition)
        camera, tool = optics.lens, body.tool.struct
        return path_is_well_conditioned(camera, body.rcm, tool, path, highest, lowest)


@compiled
def path_is_within_limits(rcm: RcmStruct, path: Floats) -> bool:
    """Return True if the path (n, 3) stays within the joint limits, minus a margin."""
    for q in path:
        for i in range(3):
            margin = JOINT_MARGIN_FRACTION * (rcm.upper[i] - rcm.lower[i])
            if not rcm.lower[i] + margin < q[i] < rcm.upper[i] - margin:
                return False
    return True


@compiled
def points_are_inside(camera: CameraStruct, points: Floats, border: float) -> bool:
    """Return True if all `points` (N, 2) px are in the image, `border` px from its border."""
    for u, v in points:
        if not (border < u < camera.width - border and border < v < camera.height - border):
            return False
    return True


@compiled
def balls_are_whole_on_path(
    camera: Rows[CameraStruct], rcm: RcmStruct, tool: ToolStruct, path: Floats, radius: float
) -> bool:
    """Return True if both balls are whole in the image and apart along the path (n, 3)."""
    for q in path:  # noqa: SIM110 Numba does not compile generators in `all`
        if not balls_are_whole(camera[0], tool, compute_position(rcm, q), radius):
            return False
    return True


@compiled
def balls_are_whole(camera: CameraStruct, tool: ToolStruct, p1: Floats, radius: float) -> bool:
    """Return True if both balls are whole in the image and apart, with marker 1 at p1 (3,) mm."""
    depth_1 = transform_to_camera(camera, p1)[2]
    depth = min(depth_1, transform_to_camera(camera, compute_second_marker(tool, p1))[2])
    if not depth > MIN_DEPTH_RADII * radius:
        return False
    m = project_markers(camera, tool, p1)
    radius_px = SILHOUETTE_MARGIN_RATIO * camera.focal * radius / depth
    are_apart = compute_distance(m[1], m[0]) > MIN_SEPARATION_RADII * radius_px
    return are_apart and points_are_inside(camera, m, radius_px + IMAGE_BORDER_PX)


@compiled
def room_is_visible(
    camera: Rows[CameraStruct], rcm: RcmStruct, tool: ToolStruct, path: Floats, room: float
) -> bool:
    """Return True if both markers stay in the image `room` mm from each joint position.

    The directions are those of the corners of a cube.
    """
    p = np.empty(3)
    for q in path:
        p1 = compute_position(rcm, q)
        for i in range(2 * len(CUBE_CORNERS)):
            reach = room if i < len(CUBE_CORNERS) else -room
            for k in range(3):
                p[k] = p1[k] + reach * CUBE_CORNERS[i % len(CUBE_CORNERS), k]
            m = project_markers(camera[0], tool, p)
            if not points_are_inside(camera[0], m, IMAGE_BORDER_PX):
                return False
    return True


@compiled
def path_is_well_conditioned(
    camera: Rows[CameraStruct],
    rcm: RcmStruct,
    tool: ToolStruct,
    path: Floats,
    max_condition: float,
    min_condition: float,
) -> bool:
    """Return True if the scaled Jacobian's condition number is in bounds along the path (n, 3).

    It is at most `max_condition` everywhere, and above `min_condition` somewhere.
    """
    o_c, worst = np.empty(2), 0.0
    o_c[0], o_c[1] = project(camera[0], np.zeros(3))
    if not all_finite(o_c):
        return False
    for q in path:
        J = compute_true_jacobian(camera[0], tool, compute_position(rcm, q), o_c)
        worst = max(worst, compute_condition(scale_rows(J)))
        if not worst <= max_condition:
            return False
    return worst > min_condition
