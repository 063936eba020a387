"""Ray-caster: images of the tool in front of the tissue.

The scene is a plane and four capsules (cylinders with round ends). The lit tissue is rendered once,
because it and the camera are static (tissue.py). Four passes then make an image: the tool's soft
shadow on the tissue (lighting.py), the capsule that each pixel shows (coverage.py), the colours of
the capsules (painting.py), and the sensor's noise (renderer.py).

All coordinates inside are in camera axes, in mm. A ray is (x, y, 1) t, so t is depth. Light is
linear, in grey levels (255 saturates). Colours are blue, green, red as in OpenCV.
"""

from rcmservo.sim.rendering.look import Appearance, Colour, Light
from rcmservo.sim.rendering.random_fields import make_random_field, sample_field
from rcmservo.sim.rendering.renderer import LightFilter, Renderer
from rcmservo.sim.rendering.tissue import Tissue

__all__ = [
    "Appearance",
    "Colour",
    "Light",
    "LightFilter",
    "Renderer",
    "Tissue",
    "make_random_field",
    "sample_field",
]
