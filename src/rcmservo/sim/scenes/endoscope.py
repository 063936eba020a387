"""An endoscope: a camera that looks at the tool through a port of its own.

Both ports are in the patient's wall, which lies across the way straight into the body. It is domed,
and the tool's port is anywhere on it: between the ports it falls or rises by up to SLOPE. An
endoscope of 0° looks along its own shaft, so from its port at the tool, and its lens is inside the
body. Where the RCM then is, before that lens, beside it or behind it, nobody asks.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.scene import SceneSettings

SLOPE = 0.35
"""rad. On a dome of 200 mm radius a port that is 130 mm from its top lies 0.33 rad below it."""

INSIDE = 10.0
"""mm of the endoscope that are in the body at least."""


def through_port(
    random: np.random.Generator, settings: SceneSettings, middle: Floats, down: Floats
) -> tuple[Floats, float] | None:
    """The unit direction (3,) from the tool's `middle` (3,) to the camera, and how far it is, mm.
    None where the camera would not be in the body."""
    assert settings.ports is not None
    port = random.uniform(*settings.ports) * on_wall(random, down)
    distance, away = random.uniform(*settings.distance), port - middle
    far = float(np.linalg.norm(away))
    return (away / far, distance) if distance <= far - INSIDE else None


def on_wall(random: np.random.Generator, down: Floats) -> Floats:
    """The unit direction (3,) from the tool's port to another one, z being up or down."""
    azimuth, slope = random.uniform(-np.pi, np.pi), random.uniform(-SLOPE, SLOPE)
    return np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * np.cos(slope) + np.sin(slope) * down
