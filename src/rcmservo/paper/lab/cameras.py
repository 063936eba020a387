"""Random cameras without distortion, so that the model (4) is exact, and their parameters."""

import numpy as np

from rcmservo.geometry.projection import extract_parameters
from rcmservo.interfaces import Floats
from rcmservo.sim import Rig, RigSettings, SceneSettings

PINHOLE = SceneSettings(distortion=(0.0, 0.0))
"""Scenes without lens distortion."""


def true_parameters(rig: Rig) -> tuple[Floats, Floats]:
    """Return a (9,) and o_c (2,) in px of the rig's camera, by Lemma 1."""
    return extract_parameters(rig.scene.optics.pinhole())


def random_camera(seed: int) -> tuple[Floats, Floats]:
    """Return C (3, 4) of a random camera, up to a random scale, and p₁ (3,) in mm at the start."""
    rig = Rig(seed, RigSettings(scene=PINHOLE), pictures=False)
    scale = np.random.default_rng(seed).uniform(-2.0, 2.0)
    return scale * rig.scene.optics.pinhole(), rig.body.points(rig.scene.start)[0]


def project_point(C: Floats, p: Floats) -> Floats:
    """Return the raw pixels (2,) of the point `p` (3,) in mm, eq. (4)."""
    m = C @ np.append(p, 1.0)
    return m[:2] / m[2]
