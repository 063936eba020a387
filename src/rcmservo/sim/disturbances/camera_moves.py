"""Motions of the camera: its pose and focal length, at once or slowly.

A slow motion is made step by step, each step from the present camera, so that other motions at the
same time are preserved.
"""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.disturbances.schedule import Event

CAMERA_MOTION_KINDS = "camera_pan", "camera_roll", "camera_dolly", "camera_zoom", "relocate"
"""Kinds that move the camera, at once or slowly. It stays where it is afterwards."""

PAN_HORIZON_S = 10.0
"""Time (s) of a slow pan for which its direction must keep both markers in the image."""

MAX_DIRECTION_TRIALS = 20
"""Directions that are tried until both markers stay in the image."""

BORDER_MARGIN_PX = 15.0
"""Distance (px) of both markers from the image border, if some direction permits it."""

BUMP_SHIFT_MM = 0.5
"""Displacement (mm) of a bumped camera, in addition to its rotation."""


class CameraMotion:
    """Motions of the camera. Each pan has its own direction, sampled when it begins."""

    def __init__(self) -> None:
        self._pan_directions: dict[Event, float] = {}

    def apply(
        self, event: Event, fraction: float, optics: CameraModel, markers: Floats
    ) -> CameraModel:
        """Return the camera after a `fraction` (0 to 1) of an event's motion.

        A pan without duration is a bump, which displaces the camera too.

        Parameters
        ----------
        event : Event
            Disturbance of one of the kinds `CAMERA_MOTION_KINDS`, except relocate.
        fraction : float
            Fraction of the motion since the previous call.
        optics : CameraModel
            Present camera.
        markers : Floats, shape (2, 3)
            Present positions of the markers, mm.
        """
        match event.kind:
            case "camera_roll":
                return roll(optics, markers, np.radians(event.number("deg")) * fraction)
            case "camera_dolly":
                return dolly(optics, event.number("mm") * fraction)
            case "camera_zoom":
                return replace(
                    optics, focal=optics.focal * (1.0 + event.number("share")) ** fraction
                )
            case _ if event.disturbance.duration_s == 0.0:
                return bump(optics, markers, event.number("px"), event.random)
            case _:
                px = event.number("px") * fraction
                return pan(optics, px, self._pan_direction(event, optics, markers))

    def _pan_direction(self, event: Event, optics: CameraModel, markers: Floats) -> float:
        """Return the direction (rad) of a pan: both markers stay in the image if possible."""
        if event not in self._pan_directions:
            px = event.number("px") * min(PAN_HORIZON_S / event.disturbance.duration_s, 1.0)
            directions = event.random.uniform(-np.pi, np.pi, MAX_DIRECTION_TRIALS)
            visible = [_shows_both(pan(optics, px, direction), markers) for direction in directions]
            self._pan_directions[event] = float(directions[int(np.argmax(visible))])
        return self._pan_directions[event]


def pan(optics: CameraModel, px: float, direction: float) -> CameraModel:
    """Return the camera after a rotation that moves the image by about `px`.

    The rotation axis is perpendicular to the optical axis, at `direction` (rad) from the image's u
    axis.
    """
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    return replace(optics, rotation=_rotation_about(axis, px / optics.focal) @ optics.rotation)


def dolly(optics: CameraModel, distance: float) -> CameraModel:
    """Return the camera after a motion of `distance` mm forward along its optical axis."""
    return replace(optics, position=optics.position + distance * optics.rotation[2])


def bump(
    optics: CameraModel, markers: Floats, px: float, random: np.random.Generator
) -> CameraModel:
    """Return the camera after a bump: a rotation and a small displacement.

    The image moves by about `px`. The `markers` (2, 3) mm stay in the image if possible.
    """
    turned = optics
    for _ in range(MAX_DIRECTION_TRIALS):
        direction = random.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(direction), np.sin(direction), 0.2 * random.standard_normal()])
        rotation = _rotation_about(axis, np.arctan(px / optics.focal)) @ optics.rotation
        shake = BUMP_SHIFT_MM * min(px / 10.0, 1.0) * random.standard_normal(3) / np.sqrt(3.0)
        turned = replace(optics, rotation=rotation, position=optics.position + shake)
        if _shows_both(turned, markers):
            break
    return turned


def roll(optics: CameraModel, markers: Floats, angle: float) -> CameraModel:
    """Return the camera after a rotation of `angle` rad about its optical axis.

    If one of the `markers` (2, 3) mm would leave the image, it rotates about the line to their
    midpoint instead.
    """
    to_tool = optics.rotation @ (markers.mean(axis=0) - optics.position)
    about_axis, about_tool = (
        replace(optics, rotation=_rotation_about(axis, angle) @ optics.rotation)
        for axis in (np.array([0.0, 0.0, 1.0]), to_tool)
    )
    return about_axis if _shows_both(about_axis, markers) else about_tool


def _shows_both(optics: CameraModel, markers: Floats) -> bool:
    """Return True if both markers are in the image, away from its border."""
    pixels = optics.project(markers)
    return bool(
        (
            (pixels > BORDER_MARGIN_PX)
            & (pixels < np.array([optics.width, optics.height]) - BORDER_MARGIN_PX)
        ).all()
    )


def _rotation_about(axis: Floats, angle: float) -> Floats:
    """Return the rotation (3, 3) by `angle` rad about an axis (3,): Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
