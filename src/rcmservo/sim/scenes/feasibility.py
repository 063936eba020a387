"""Feasibility of a scene: joint limits, visible markers and the Jacobian's condition number."""

from dataclasses import dataclass

import numpy as np

from rcmservo.control.saturated_controller import scale_rows
from rcmservo.geometry.kinematics import RcmStruct, compute_position
from rcmservo.geometry.tool import ToolStruct, compute_second_marker
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import all_finite
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
"""Distance (px) of both imaged balls from the image border."""

MIN_SEPARATION_RADII = 3.0
"""Least distance of the imaged markers, in radii of the larger one: neither hides the other."""

CUBE_CORNERS = np.array(
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
) / np.sqrt(3.0)
"""Half of the corners of a cube, 1 from its centre; the other half is opposite to them."""

JOINT_MARGIN_FRACTION = 0.03
"""Fraction of each joint's range between the path and a joint limit."""


@dataclass(frozen=True, eq=False)
class SceneFeasibility:
    """Test of scenes.

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

        If the user gives both ends, only visibility counts.
        """
        optics, path, half_way = scene.optics, scene.path, scene.midpoint[None]
        if self.settings.is_sampled and not path_is_within_limits(self.body.rcm, path):
            return False
        if not (self.markers_visible(optics, path) and self.markers_visible(optics, half_way)):
            return False
        if not self.settings.is_sampled:
            return True
        explored = path[:1] if self.settings.errors is None else np.stack([path[0], half_way[0]])
        return self._has_room(optics, explored) and self.is_well_conditioned(optics, path)

    def markers_visible(self, optics: CameraModel, path: Floats) -> bool:
        """Return True if both balls are whole and apart in the image along the path (n, 3)."""
        body = self.body
        return path_is_visible(optics.lens, body.rcm, body.tool.struct, path, self.radius)

    def is_well_conditioned(self, optics: CameraModel, path: Floats) -> bool:
        """Return True if the scaled Jacobian is conditioned as required along the path (n, 3).

        Always True for an endoscope: no Jacobian exists about an RCM that the camera cannot image.
        """
        if self.settings.ports is not None:
            return True
        body, settings = self.body, self.settings
        upper, lower = float(settings.max_condition), float(settings.min_condition)
        return path_is_well_conditioned(optics.lens, body.rcm, body.tool.struct, path, upper, lower)

    def _has_room(self, optics: CameraModel, path: Floats) -> bool:
        """Return True if both markers stay in the image around all the joints (n, 3)."""
        body, room = self.body, self.settings.room
        return room_is_visible(optics.lens, body.rcm, body.tool.struct, path, float(room))


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
def points_are_inside(lens: CameraStruct, points: Floats, border: float) -> bool:
    """Return True if all `points` (N, 2) px are in the image, `border` px from its border."""
    for u, v in points:
        if not (border < u < lens.width - border and border < v < lens.height - border):
            return False
    return True


@compiled
def path_is_visible(
    lens: Rows[CameraStruct], rcm: RcmStruct, shaft: ToolStruct, path: Floats, radius: float
) -> bool:
    """Return `SceneFeasibility.markers_visible`."""
    for q in path:  # noqa: SIM110 Numba does not compile generators in `all`
        if not balls_are_whole(lens[0], shaft, compute_position(rcm, q), radius):
            return False
    return True


@compiled
def balls_are_whole(lens: CameraStruct, shaft: ToolStruct, p1: Floats, radius: float) -> bool:
    """Return True if both balls are whole in the image and apart, with marker 1 at p1 (3,) mm."""
    depth = min(
        transform_to_camera(lens, p1)[2],
        transform_to_camera(lens, compute_second_marker(shaft, p1))[2],
    )
    if not depth > 5.0 * radius:
        return False
    m, r = project_markers(lens, shaft, p1), 1.2 * lens.focal * radius / depth
    are_apart = (
        np.sqrt((m[1, 0] - m[0, 0]) ** 2 + (m[1, 1] - m[0, 1]) ** 2) > MIN_SEPARATION_RADII * r
    )
    return are_apart and points_are_inside(lens, m, r + IMAGE_BORDER_PX)


@compiled
def room_is_visible(
    lens: Rows[CameraStruct], rcm: RcmStruct, shaft: ToolStruct, path: Floats, room: float
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
            if not points_are_inside(lens[0], project_markers(lens[0], shaft, p), IMAGE_BORDER_PX):
                return False
    return True


@compiled
def path_is_well_conditioned(
    lens: Rows[CameraStruct],
    rcm: RcmStruct,
    shaft: ToolStruct,
    path: Floats,
    max_condition: float,
    min_condition: float,
) -> bool:
    """Return True if the scaled Jacobian's condition number is in bounds along the path (n, 3).

    It is at most `max_condition` everywhere, and above `min_condition` somewhere.
    """
    o_c, worst = np.empty(2), 0.0
    o_c[0], o_c[1] = project(lens[0], np.zeros(3))
    if not all_finite(o_c):
        return False
    for q in path:
        J = compute_true_jacobian(lens[0], shaft, compute_position(rcm, q), o_c)
        worst = max(worst, compute_condition(scale_rows(J)))
        if not worst <= max_condition:
            return False
    return worst > min_condition
