"""Simulated laboratory of a rig file: its sections [camera], [drive], [imperfections] and so on."""

from dataclasses import dataclass, fields, replace

from rcmservo.config.rig_file import RigDescription
from rcmservo.errors import require
from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.imperfections import ARMS, Imperfections
from rcmservo.sim.rendering import Appearance, Colour
from rcmservo.sim.rig import ImageSettings, RigSettings
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
"""Colour (blue, green, red) in grey levels of a simulated ball, by its name in [markers]."""


@dataclass(frozen=True)
class CameraSection(ImageSettings, Timing, section="camera"):
    """Section [camera] of a rig file, with the fields of `ImageSettings` and of `Timing`."""


def read_rig_settings(lab: RigDescription, arm: str = "ideal") -> RigSettings:
    """Return the settings of the simulated laboratory that a rig file describes.

    Its arm has the imperfections of the file, or those of the quality `arm`, one of `ARMS`.
    """
    if ARMS[arm]:
        expected = "ideal: the rig file has imperfections of its own"
        require("imperfections" not in lab.simulation, "arm", arm, expected)
        sections = {
            name: {**lab.simulation.get(name, {}), **content} for name, content in ARMS[arm].items()
        }
        lab = replace(lab, simulation={**lab.simulation, **sections})
    camera = lab.decode_simulation_settings("camera", CameraSection)
    timing, image = (
        {field.name: getattr(camera, field.name) for field in fields(base)}
        for base in (Timing, ImageSettings)
    )
    markers = lab.markers
    appearance = lab.decode_simulation_settings(
        "appearance",
        Appearance,
        marker_radii=(markers.radius_1, markers.radius_2),
        marker_colours=(BALL_COLOURS[markers.colour_1], BALL_COLOURS[markers.colour_2]),
    )
    return RigSettings(
        mechanism=lab.mechanism,
        tool=lab.tool,
        drive=lab.decode_simulation_settings("drive", Drive),
        timing=Timing(**timing),
        appearance=appearance,
        scene=lab.decode_simulation_settings("scene", SceneSettings),
        imperfections=lab.decode_simulation_settings("imperfections", Imperfections),
        **image,
    )
