"""Endoscope: random pose of a camera that observes the tool through its own port.

The ports of the endoscope and of the tool are in the abdominal wall, which is roughly perpendicular
to the direction straight into the body. The wall is domed: it falls or rises between the ports by a
slope of up to `MAX_WALL_SLOPE_RAD`. A 0° endoscope looks along its own shaft, from its port to the
tool, and its lens is inside the body. The RCM may be in front of the lens, to its side or behind.
"""

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.scene import SceneSettings

MAX_WALL_SLOPE_RAD = 0.35
"""Largest slope of the line between the ports, rad. On a dome of 200 mm radius, the line from the
top to a port 130 mm away slopes by 0.33 rad."""

MIN_INSERTED_LENGTH_MM = 10.0
"""Least length (mm) of the endoscope inside the body."""


def sample_endoscope_view(
    random: np.random.Generator, settings: SceneSettings, middle: Floats, down: Floats
) -> tuple[Floats, float] | None:
    """Sample the direction and the distance from the tool to an endoscope's lens.

    Parameters
    ----------
    random : numpy.random.Generator
        Generator of random numbers.
    settings : SceneSettings
        Distributions; `ports` must be given.
    middle : Floats, shape (3,)
        Middle of the tool, mm.
    down : Floats, shape (3,)
        Unit vector straight into the body.

    Returns
    -------
    tuple or None
        Unit vector (3,) from the tool to the lens and their distance (mm); None if the lens
        would be outside the body.
    """
    assert settings.ports is not None
    port = random.uniform(*settings.ports) * sample_along_wall(random, down)
    distance, to_port = random.uniform(*settings.distance), port - middle
    port_distance = float(np.linalg.norm(to_port))
    if distance > port_distance - MIN_INSERTED_LENGTH_MM:
        return None
    return to_port / port_distance, distance


def sample_along_wall(random: np.random.Generator, down: Floats) -> Floats:
    """Sample the unit vector (3,) from the tool's port to another port; `down` is ±z."""
    azimuth = random.uniform(-np.pi, np.pi)
    slope = random.uniform(-MAX_WALL_SLOPE_RAD, MAX_WALL_SLOPE_RAD)
    return np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * np.cos(slope) + np.sin(slope) * down
