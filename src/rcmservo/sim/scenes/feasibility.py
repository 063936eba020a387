"""Whether a scene is one that the method is made for."""

from dataclasses import dataclass

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.interfaces import Floats
from rcmservo.loops import all_finite
from rcmservo.method.controller import scaled
from rcmservo.method.kinematics import Rcm, position
from rcmservo.method.tool import Shaft, second_marker
from rcmservo.numerics.small_svd import condition
from rcmservo.rows import Rows
from rcmservo.sim.camera_kernels import Lens, in_camera, markers, project, true_jacobian
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.scene import Scene, SceneSettings
from rcmservo.sim.tool_body import Body

BORDER = 12.0
"""px that both imaged balls keep from the picture's border."""

SEPARATION = 3.0
"""Least distance of the imaged markers, in radii of the larger one: neither hides the other."""

CORNERS = np.array(
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
) / np.sqrt(3.0)
"""Half of the corners of a cube, 1 from its middle; the others are opposite to them."""

MARGIN = 0.03
"""The share of each joint's range that the way keeps from its limits."""


@dataclass(frozen=True, eq=False)
class Fitness:
    """The judge of scenes."""

    settings: SceneSettings
    """What scenes are drawn from."""

    body: Body
    """The tool."""

    radius: float
    """mm, that of the larger ball."""

    def suits(self, scene: Scene) -> bool:
        """Whether a scene may be used. Of a scene of the user's own only visibility is asked."""
        optics, way, half_way = scene.optics, scene.way, scene.half_way[None]
        if self.settings.free and not inside(self.body.rcm, way):
            return False
        if not (self.visible(optics, way) and self.visible(optics, half_way)):
            return False
        if not self.settings.free:
            return True
        explored = way[:1] if self.settings.errors is None else np.stack([way[0], half_way[0]])
        return self._room(optics, explored) and self.regular(optics, way)

    def visible(self, optics: Optics, way: Floats) -> bool:
        """Whether both balls are whole in the picture and apart from each other, all along the way
        (n, 3)."""
        body = self.body
        return visible(optics.lens, body.rcm, body.tool.shaft, way, self.radius)

    def regular(self, optics: Optics, way: Floats) -> bool:
        """Whether the scaled Jacobian is conditioned along the way (n, 3) as was asked for.

        Through a port nothing is asked: about an RCM that is not seen there is none.
        """
        if self.settings.ports is not None:
            return True
        body, s = self.body, self.settings
        most, least = float(s.max_condition), float(s.min_condition)
        return regular(optics.lens, body.rcm, body.tool.shaft, way, most, least)

    def _room(self, optics: Optics, way: Floats) -> bool:
        """Whether both markers stay in the picture about all the joints (n, 3)."""
        body, room = self.body, self.settings.room
        return roomy(optics.lens, body.rcm, body.tool.shaft, way, float(room))


@compiled
def inside(rcm: Rcm, way: Floats) -> bool:
    """Whether the way (n, 3) keeps off the joints' limits."""
    for q in way:
        for i in range(3):
            margin = MARGIN * (rcm.upper[i] - rcm.lower[i])
            if not rcm.lower[i] + margin < q[i] < rcm.upper[i] - margin:
                return False
    return True


@compiled
def within(lens: Lens, points: Floats, border: float) -> bool:
    """Whether all `points` (N, 2) px are in the picture, more than `border` px from its border."""
    for u, v in points:
        if not (border < u < lens.width - border and border < v < lens.height - border):
            return False
    return True


@compiled
def visible(lens: Rows[Lens], rcm: Rcm, shaft: Shaft, way: Floats, radius: float) -> bool:
    """`Fitness.visible`."""
    for q in way:  # noqa: SIM110 Numba compiles no generators in `all`
        if not whole(lens[0], shaft, position(rcm, q), radius):
            return False
    return True


@compiled
def whole(lens: Lens, shaft: Shaft, p1: Floats, radius: float) -> bool:
    """Whether both balls are whole in the picture and apart, with marker 1 at p1 (3,) mm."""
    depth = min(in_camera(lens, p1)[2], in_camera(lens, second_marker(shaft, p1))[2])
    if not depth > 5.0 * radius:
        return False
    m, r = markers(lens, shaft, p1), 1.2 * lens.focal * radius / depth
    apart = np.sqrt((m[1, 0] - m[0, 0]) ** 2 + (m[1, 1] - m[0, 1]) ** 2) > SEPARATION * r
    return apart and within(lens, m, r + BORDER)


@compiled
def roomy(lens: Rows[Lens], rcm: Rcm, shaft: Shaft, way: Floats, room: float) -> bool:
    """Whether both markers stay in the picture `room` mm from each place, towards the CORNERS and
    away from them."""
    p = np.empty(3)
    for q in way:
        p1 = position(rcm, q)
        for i in range(2 * len(CORNERS)):
            reach = room if i < len(CORNERS) else -room
            for k in range(3):
                p[k] = p1[k] + reach * CORNERS[i % len(CORNERS), k]
            if not within(lens[0], markers(lens[0], shaft, p), BORDER):
                return False
    return True


@compiled
def regular(
    lens: Rows[Lens], rcm: Rcm, shaft: Shaft, way: Floats, most: float, least: float
) -> bool:
    """Whether the scaled Jacobian's condition is at most `most` along the way (n, 3), and somewhere
    on it above `least`."""
    o_c, worst = np.empty(2), 0.0
    o_c[0], o_c[1] = project(lens[0], np.zeros(3))
    if not all_finite(o_c):
        return False
    for q in way:
        J = true_jacobian(lens[0], shaft, position(rcm, q), o_c)
        worst = max(worst, condition(scaled(J)))
        if not worst <= most:
            return False
    return worst > least
