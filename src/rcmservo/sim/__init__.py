"""The simulated laboratory. Simulation is simulation: its truth is kept where the servo cannot
reach it."""

from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.disturb import Disturbance, Killed
from rcmservo.sim.renderer import Look
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
