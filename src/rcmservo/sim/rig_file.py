"""Sections of a rig file that only the simulation reads: [camera], [drive], [look] and [scene]."""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.config.rig_file import Lab
from rcmservo.constraints import Checked
from rcmservo.sim import Look
from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.rendering import Colour
from rcmservo.sim.rig import IMAGE_SIZE_LIMIT, POINT_NOISE_LIMIT, RigSettings
from rcmservo.sim.scene import SceneSettings

BALL_COLOURS: dict[str, Colour] = {
    "red": (40.0, 35.0, 215.0),
    "green": (60.0, 185.0, 30.0),
    "blue": (205.0, 80.0, 25.0),
    "yellow": (30.0, 200.0, 210.0),
    "cyan": (200.0, 185.0, 30.0),
    "magenta": (190.0, 40.0, 200.0),
    "bright": (235.0, 235.0, 235.0),
}
"""Colour (blue, green, red) of a simulated ball by the colour for which the tracker looks."""


@dataclass(frozen=True)
class CameraSection(Checked, section="camera"):
    """Section [camera] of a rig file."""

    width: Annotated[int, IMAGE_SIZE_LIMIT] = 640
    """Width of the image, px."""
    height: Annotated[int, IMAGE_SIZE_LIMIT] = 480
    """Height of the image, px."""
    frame_rate: float = 60.0
    """Frame rate, frames/s."""
    exposure: float = 0.004
    """Exposure time, s."""
    delay: float = 0.02
    """Time (s) from the end of an exposure to the arrival of its frame."""
    point_noise: Annotated[float, POINT_NOISE_LIMIT] = 0.3
    """Root mean square noise (px) of the markers of the camera without images."""


def rig_settings(lab: Lab) -> RigSettings:
    """Return the settings of the simulated laboratory that a rig file describes."""
    camera = lab.section("camera", CameraSection)
    return RigSettings(
        mechanism=lab.mechanism,
        tool=lab.tool,
        drive=lab.section("drive", Drive),
        timing=Timing(camera.frame_rate, camera.exposure, camera.delay),
        look=lab.section("look", Look, **_marker_appearance(lab)),
        scene=lab.section("scene", SceneSettings),
        width=camera.width,
        height=camera.height,
        point_noise=camera.point_noise,
    )


def _marker_appearance(lab: Lab) -> dict[str, tuple[float, float] | tuple[Colour, Colour]]:
    """Return the fields of `Look` that follow from the section [markers]."""
    markers = lab.markers
    return {
        "marker_radii": (markers.radius_1, markers.radius_2),
        "marker_colours": (BALL_COLOURS[markers.colour_1], BALL_COLOURS[markers.colour_2]),
    }
