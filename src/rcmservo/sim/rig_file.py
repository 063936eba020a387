"""The parts of a rig file that only a simulation reads: [camera], [drive], [look] and [scene]."""

from dataclasses import dataclass, fields
from typing import Any, cast

from rcmservo.config.rig_file import Lab
from rcmservo.constraints import Checked
from rcmservo.sim import Look
from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.rendering import Colour
from rcmservo.sim.rig import Picture, RigSettings
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
class CameraSection(Picture, Timing, section="camera"):
    """[camera] of a rig file."""


def rig_settings(lab: Lab) -> RigSettings:
    """The simulated laboratory of a rig file's [camera], [drive], [look] and [scene]."""
    camera = lab.section("camera", CameraSection)
    return RigSettings(
        mechanism=lab.mechanism,
        tool=lab.tool,
        drive=lab.section("drive", Drive),
        timing=Timing(**_values(camera, Timing)),
        look=lab.section("look", Look, **_paint(lab)),
        scene=lab.section("scene", SceneSettings),
        **_values(camera, Picture),
    )


def _values(camera: CameraSection, kind: type[Checked]) -> dict[str, Any]:
    """Return the settings of a base class of [camera]."""
    return {f.name: getattr(camera, f.name) for f in fields(cast(Any, kind))}


def _paint(lab: Lab) -> dict[str, tuple[float, float] | tuple[Colour, Colour]]:
    """The part of a Look that [markers] tells."""
    markers = lab.markers
    return {
        "marker_radii": (markers.radius_1, markers.radius_2),
        "marker_colours": (PAINTS[markers.colour_1], PAINTS[markers.colour_2]),
    }
