"""The simulated laboratory. Its truth is kept where the servo cannot reach it."""

from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.disturbances import Disturbance, Killed
from rcmservo.sim.rendering import Look
from rcmservo.sim.rig import Rig, RigSettings
from rcmservo.sim.scene import SceneSettings

__all__ = [
    "Disturbance",
    "Drive",
    "Killed",
    "Look",
    "Rig",
    "RigSettings",
    "SceneSettings",
    "Timing",
]
