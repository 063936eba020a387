"""Whether a scene is one that the method is made for."""

from dataclasses import dataclass

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.controller import scaled
from rcmservo.method.exploration import CORNERS
from rcmservo.sim.body import Body
from rcmservo.sim.optics import Optics
from rcmservo.sim.scene import Scene, SceneSettings
from rcmservo.sim.scene_ways import imaged_rcm
from rcmservo.sim.truth import feature_jacobian

BORDER = 12.0
"""px that both imaged balls keep from the picture's border."""

SEPARATION = 3.0
"""Least distance of the imaged markers, in radii of the larger one: neither hides the other."""

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
        if self.settings.free and not self._inside(scene.way):
            return False
        if not all(self.visible(scene.optics, q) for q in (*scene.way, scene.half_way)):
            return False
        if not self.settings.free:
            return True
        explored = [scene.start] if self.settings.errors is None else [scene.start, scene.half_way]
        room = all(self._room(scene.optics, q) for q in explored)
        return room and self.regular(scene.optics, scene.way)

    def visible(self, optics: Optics, q: Floats) -> bool:
        """Whether both balls are whole in the picture and apart from each other."""
        markers = self.body.points(q)[:2]
        depth = optics.depth(markers)
        if not (depth > 5.0 * self.radius).all():
            return False
        m = optics.project(markers)
        r = float(np.max(optics.focal * self.radius / depth)) * 1.2
        apart = np.linalg.norm(m[1] - m[0]) > SEPARATION * r
        return bool(apart) and within(optics, m, r + BORDER)

    def regular(self, optics: Optics, way: Floats) -> bool:
        """Whether the scaled Jacobian is well conditioned along the way."""
        o_c = imaged_rcm(optics)
        if not np.isfinite(o_c).all():
            return False
        jacobians = (scaled(feature_jacobian(self.body, optics, q, o_c)) for q in way)
        return all(np.linalg.cond(J) <= self.settings.max_condition for J in jacobians)

    def _inside(self, way: Floats) -> bool:
        """Whether the way keeps off the joints' limits."""
        limits = self.body.mechanism.limits
        lower, upper = np.array(limits.lower), np.array(limits.upper)
        margin = MARGIN * (upper - lower)
        return bool(((way > lower + margin) & (way < upper - margin)).all())

    def _room(self, optics: Optics, q: Floats) -> bool:
        """Whether both markers stay in the picture about the joints q (3,)."""
        around = self.body.points(q)[0] + self.settings.room * np.concatenate([CORNERS, -CORNERS])
        second = [self.body.tool.second_marker(p) for p in around]
        return within(optics, optics.project(np.concatenate([around, second])), BORDER)


def within(optics: Optics, points: Floats, border: float) -> bool:
    """Whether all `points` (N, 2) px are in the picture, more than `border` px from its border."""
    size = np.array([optics.width, optics.height])
    return bool(((points > border) & (points < size - border)).all())
