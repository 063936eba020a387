"""Sections of a rig file for the simulation: [camera], [drive], [appearance] and [scene]."""

from dataclasses import dataclass, fields
from typing import Any, cast

from rcmservo.config.rig_file import RigDescription
from rcmservo.constraints import Checked
from rcmservo.sim import Appearance
from rcmservo.sim.arm import Drive
from rcmservo.sim.cameras import Timing
from rcmservo.sim.rendering import Colour
from rcmservo.sim.rig import Picture, RigSettings
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
class CameraSection(Picture, Timing, section="camera"):
    """Section [camera] of a rig file."""


def read_rig_settings(lab: RigDescription) -> RigSettings:
    """Return the settings of the simulated laboratory that a rig file describes."""
    camera = lab.simulation_settings("camera", CameraSection)
    return RigSettings(
        mechanism=lab.mechanism,
        tool=lab.tool,
        drive=lab.simulation_settings("drive", Drive),
        timing=Timing(**_values(camera, Timing)),
        appearance=lab.simulation_settings("appearance", Appearance, **_marker_appearance(lab)),
        scene=lab.simulation_settings("scene", SceneSettings),
        **_values(camera, Picture),
    )


def _values(camera: CameraSection, kind: type[Checked]) -> dict[str, Any]:
    """Return the settings of a base class of [camera]."""
    return {f.name: getattr(camera, f.name) for f in fields(cast(Any, kind))}


def _marker_appearance(
    lab: RigDescription,
) -> dict[str, tuple[float, float] | tuple[Colour, Colour]]:
    """Return the fields of `Appearance` that follow from the section [markers]."""
    markers = lab.markers
    return {
        "marker_radii": (markers.radius_1, markers.radius_2),
        "marker_colours": (BALL_COLOURS[markers.colour_1], BALL_COLOURS[markers.colour_2]),
    }
