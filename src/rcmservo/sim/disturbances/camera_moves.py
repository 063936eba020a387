"""Pose and focal length of the camera after it was bumped into, rolled or zoomed at once, or
while it is turned or pushed slowly.

What moves it slowly does so step by step, each from where it stands by then: whatever else moves it
meanwhile is kept.
"""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import Optics
from rcmservo.sim.disturbances.schedule import Event

MOVES = "camera_pan", "camera_roll", "camera_dolly", "camera_zoom", "relocate"
"""The kinds that move it, at once or slowly. It stays where it is then."""

FARTHEST = 10.0
"""s of a slow turn for which a direction is sought that keeps both markers in the picture."""

TRIES = 20
"""Bumps that are tried until both markers stay in the picture."""

BORDER = 15.0
"""px that both markers keep from the picture's border, if a bump lets them."""

SHAKE = 0.5
"""mm by which a bumped camera is displaced. It is turned as well."""


class Hands:
    """The motions of the camera. Each pan has a direction of its own, drawn when it begins."""

    def __init__(self) -> None:
        self._ways: dict[Event, float] = {}

    def moved(self, event: Event, part: float, optics: Optics, markers: Floats) -> Optics:
        """The camera after a part, 0 to 1, of an event's motion.

        `markers` (2, 3) mm is where they are meanwhile. A pan at once is a bump, which shakes the
        camera too.
        """
        match event.kind:
            case "camera_roll":
                return rolled(optics, markers, np.radians(event.number("deg")) * part)
            case "camera_dolly":
                return pushed(optics, event.number("mm") * part)
            case "camera_zoom":
                return replace(optics, focal=optics.focal * (1.0 + event.number("share")) ** part)
            case _ if event.disturbance.lasts == 0.0:
                return bumped(optics, markers, event.number("px"), event.random)
            case _:
                px = event.number("px") * part
                return panned(optics, px, self._way(event, optics, markers))

    def _way(self, event: Event, optics: Optics, markers: Floats) -> float:
        """In which direction an event turns the camera, rad: both markers stay in the picture if
        that can be."""
        if event not in self._ways:
            px = event.number("px") * min(FARTHEST / event.disturbance.lasts, 1.0)
            ways = event.random.uniform(-np.pi, np.pi, TRIES)
            good = [_shows(panned(optics, px, way), markers) for way in ways]
            self._ways[event] = float(ways[int(np.argmax(good))])
        return self._ways[event]


def panned(optics: Optics, px: float, way: float) -> Optics:
    """The camera turned about an axis across its line of sight, so that the picture moves by about
    `px`. The axis is at `way` rad from the picture's u."""
    axis = np.array([np.cos(way), np.sin(way), 0.0])
    return replace(optics, rotation=_turn(axis, px / optics.focal) @ optics.rotation)


def pushed(optics: Optics, way: float) -> Optics:
    """The camera moved along its line of sight by `way` mm, towards what it sees."""
    return replace(optics, position=optics.position + way * optics.rotation[2])


def bumped(optics: Optics, markers: Floats, px: float, random: np.random.Generator) -> Optics:
    """The camera turned in some direction, so that the picture jumps by about `px`.

    It goes on showing the `markers` (2, 3) mm if that can be.
    """
    turned = optics
    for _ in range(TRIES):
        way = random.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(way), np.sin(way), 0.2 * random.standard_normal()])
        rotation = _turn(axis, np.arctan(px / optics.focal)) @ optics.rotation
        shake = SHAKE * min(px / 10.0, 1.0) * random.standard_normal(3) / np.sqrt(3.0)
        turned = replace(optics, rotation=rotation, position=optics.position + shake)
        if _shows(turned, markers):
            break
    return turned


def rolled(optics: Optics, markers: Floats, angle: float) -> Optics:
    """The camera turned by `angle` rad about its line of sight.

    Should one of the `markers` (2, 3) mm leave the picture, it is turned about the line to their
    middle instead.
    """
    to_tool = optics.rotation @ (markers.mean(axis=0) - optics.position)
    about_axis, about_tool = (
        replace(optics, rotation=_turn(axis, angle) @ optics.rotation)
        for axis in (np.array([0.0, 0.0, 1.0]), to_tool)
    )
    return about_axis if _shows(about_axis, markers) else about_tool


def _shows(optics: Optics, markers: Floats) -> bool:
    """Return True if both markers are in the picture, away from its border."""
    seen = optics.project(markers)
    return bool(((seen > BORDER) & (seen < np.array([optics.width, optics.height]) - BORDER)).all())


def _turn(axis: Floats, angle: float) -> Floats:
    """The rotation (3, 3) by `angle` rad about an axis (3,): Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
