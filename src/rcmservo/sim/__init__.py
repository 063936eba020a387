"""Simulated laboratory: arm, camera, tool, scene and disturbances.

The true state stays inside this package; no servo can read it.
"""

from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.disturbances import Disturbance, Killed
from rcmservo.sim.rendering import Appearance
from rcmservo.sim.rig import Rig, RigSettings
from rcmservo.sim.scene import SceneSettings

__all__ = [
    "Appearance",
    "Disturbance",
    "Drive",
    "Killed",
    "Rig",
    "RigSettings",
    "SceneSettings",
    "Timing",
]
