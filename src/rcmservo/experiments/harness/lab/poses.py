"""Poses as a person would choose them to show, and what a pixel of noise means there."""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.method.features import about, features_jacobian
from rcmservo.sim import Rig

BORDER = 25.0
"""px that a pose's markers keep from the picture's border."""


def drawn_poses(rig: Rig, count: int, spread: float) -> list[Floats]:
    """Joints (3,) of poses within `spread` mm of the start that the camera sees, as a person would
    choose them."""
    random = np.random.default_rng(rig.seed)
    kinematics, size = rig.settings.mechanism, np.array([rig.settings.width, rig.settings.height])
    start = kinematics.position(rig.scene.start)
    poses: list[Floats] = []
    while len(poses) < count:
        way = random.standard_normal(3)
        q = kinematics.joints(start + spread * random.uniform(0.5, 1.0) * way / np.linalg.norm(way))
        m = rig.truth.pixels(q)
        inside = (q > kinematics.limits.lower) & (q < kinematics.limits.upper)
        if inside.all() and ((m > BORDER) & (m < size - BORDER)).all():
            poses.append(q)
    return poses


def pose_per_pixel(rig: Rig, q: Floats) -> float:
    """rms mm by which marker 1 is misplaced at the joints q (3,) for one pixel of noise in every
    coordinate."""
    o_c = rig.truth.imaged_rcm()
    noise = features_jacobian(about(rig.truth.pixels(q), o_c))
    return float(np.linalg.norm(np.linalg.solve(rig.truth.jacobian(q, o_c), noise)))
