"""Pictures of the tool over the tissue: a ray-caster for one still camera, a plane, four capsules.

The camera and the tissue stand still, so the lit tissue is painted once. A picture is then made in
four passes: the tool's soft shadow on the tissue (shadow.py); which capsule each pixel sees
(coverage.py); the capsules' colours (painting.py); the sensor's noise (sensor.py).

Inside, everything is in camera axes, in mm. A ray is (x, y, 1) t, so t is depth. Light is linear,
in grey levels (255 saturates). Colours are blue, green, red as in OpenCV.
"""

from rcmservo.sim.rendering.look import Colour, Light, Look
from rcmservo.sim.rendering.random_fields import random_field, sampled
from rcmservo.sim.rendering.renderer import Between, Renderer
from rcmservo.sim.rendering.tissue import Tissue

__all__ = [
    "Between",
    "Colour",
    "Light",
    "Look",
    "Renderer",
    "Tissue",
    "random_field",
    "sampled",
]
