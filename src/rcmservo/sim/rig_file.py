"""The parts of a rig file that only a simulation reads: [camera], [drive], [look] and [scene]."""

from dataclasses import dataclass
from typing import Annotated

from rcmservo.config.rig_file import Lab
from rcmservo.constraints import Checked
from rcmservo.sim import Look
from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.rendering import Colour
from rcmservo.sim.rig import NOISE, PIXELS, RigSettings
from rcmservo.sim.scene import SceneSettings

PAINTS: dict[str, Colour] = {
    "red": (40.0, 35.0, 215.0),
    "green": (60.0, 185.0, 30.0),
    "blue": (205.0, 80.0, 25.0),
    "yellow": (30.0, 200.0, 210.0),
    "cyan": (200.0, 185.0, 30.0),
    "magenta": (190.0, 40.0, 200.0),
    "bright": (235.0, 235.0, 235.0),
}
"""Paint (blue, green, red) of a simulated ball by the colour that the tracker looks for."""


@dataclass(frozen=True)
class CameraSection(Checked, section="camera"):
    """[camera] of a rig file."""

    width: Annotated[int, PIXELS] = 640
    """Of the picture, px."""
    height: Annotated[int, PIXELS] = 480
    """Of the picture, px."""
    frame_rate: float = 60.0
    """Frames a second."""
    exposure: float = 0.004
    """s for which a frame is exposed."""
    delay: float = 0.02
    """s from the end of the exposure to the frame's arrival."""
    point_noise: Annotated[float, NOISE] = 0.3
    """px, root mean square, of a camera that delivers points."""


def rig_settings(lab: Lab) -> RigSettings:
    """The simulated laboratory of a rig file's [camera], [drive], [look] and [scene]."""
    camera = lab.section("camera", CameraSection)
    return RigSettings(
        mechanism=lab.mechanism,
        tool=lab.tool,
        drive=lab.section("drive", Drive),
        timing=Timing(camera.frame_rate, camera.exposure, camera.delay),
        look=lab.section("look", Look, **_paint(lab)),
        scene=lab.section("scene", SceneSettings),
        width=camera.width,
        height=camera.height,
        point_noise=camera.point_noise,
    )


def _paint(lab: Lab) -> dict[str, tuple[float, float] | tuple[Colour, Colour]]:
    """The part of a Look that [markers] tells."""
    markers = lab.markers
    return {
        "marker_radii": (markers.radius_1, markers.radius_2),
        "marker_colours": (PAINTS[markers.colour_1], PAINTS[markers.colour_2]),
    }
