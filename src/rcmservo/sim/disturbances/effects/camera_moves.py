"""Motions of the camera: pan, roll, dolly, zoom and bump, at once or slowly.

A slow motion consists of small steps from the present camera, so that motions at the same time add
up. `CameraModel` is the simulated camera: its pose in the world and its lens.
"""

from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.camera_model import CameraModel
from rcmservo.sim.disturbances.schedule import Event

CAMERA_MOTION_KINDS = "camera_pan", "camera_roll", "camera_dolly", "camera_zoom", "relocate"
"""Kinds of disturbance that move the camera. It does not return afterwards."""

PAN_HORIZON_S = 10.0
"""Time (s) of a slow pan in which both markers should stay in the image: its direction is chosen
for that."""

MAX_DIRECTION_TRIALS = 20
"""Directions that are tried until both markers stay in the image."""

BORDER_MARGIN_PX = 15.0
"""Distance (px) of a marker from the image border within which it counts as leaving the image."""

BUMP_SHIFT_MM = 0.5
"""Displacement (mm) of a bumped camera, in addition to its rotation."""


class CameraMotion:
    """Motions of the camera by disturbances.

    It stores the direction of each slow pan, which is sampled when the pan begins.
    """

    def __init__(self) -> None:
        self._pan_directions: dict[Event, float] = {}

    def apply(
        self, event: Event, fraction: float, camera: CameraModel, markers: Floats
    ) -> CameraModel:
        """Return the camera after a `fraction` (0 to 1) of a disturbance's motion.

        A pan without duration is a bump, which also displaces the camera.

        Parameters
        ----------
        event : Event
            Disturbance of a kind in `CAMERA_MOTION_KINDS`, except relocate.
        fraction : float
            Fraction of the motion since the previous call.
        camera : CameraModel
            Present camera.
        markers : Floats, shape (2, 3)
            Present positions of the markers, mm.
        """
        match event.kind:
            case "camera_roll":
                return roll(camera, markers, np.radians(event.number("deg")) * fraction)
            case "camera_dolly":
                shift_mm = event.number("mm") * fraction
                return replace(camera, position=camera.position + shift_mm * camera.rotation[2])
            case "camera_zoom":
                magnification = (1.0 + event.number("share")) ** fraction
                return replace(camera, focal=camera.focal * magnification)
            case _ if event.disturbance.duration_s == 0.0:
                return bump(camera, markers, event.number("px"), event.random)
            case _:
                shift_px = event.number("px") * fraction
                return pan(camera, shift_px, self._choose_direction(event, camera, markers))

    def _choose_direction(self, event: Event, camera: CameraModel, markers: Floats) -> float:
        """Return the direction (rad) of a pan, in which both markers stay visible if possible."""
        if event not in self._pan_directions:
            shift_px = event.number("px") * min(PAN_HORIZON_S / event.disturbance.duration_s, 1.0)
            directions = event.random.uniform(-np.pi, np.pi, MAX_DIRECTION_TRIALS)
            are_visible = [markers_visible(pan(camera, shift_px, d), markers) for d in directions]
            self._pan_directions[event] = float(directions[int(np.argmax(are_visible))])
        return self._pan_directions[event]


def pan(camera: CameraModel, shift_px: float, direction: float) -> CameraModel:
    """Return the camera after a rotation that moves the image by about `shift_px`.

    The rotation axis is perpendicular to the optical axis, at `direction` (rad) from the image's u
    axis.
    """
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    return rotate(camera, axis, shift_px / camera.focal)


def bump(
    camera: CameraModel, markers: Floats, shift_px: float, random: np.random.Generator
) -> CameraModel:
    """Return the camera after a bump: a rotation and a small displacement.

    The image moves by about `shift_px`. The `markers` (2, 3) mm stay in the image if possible.
    """
    bumped = camera
    for _ in range(MAX_DIRECTION_TRIALS):
        direction = random.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(direction), np.sin(direction), 0.2 * random.standard_normal()])
        max_shift_mm = BUMP_SHIFT_MM * min(shift_px / 10.0, 1.0)
        shift_mm = max_shift_mm * random.standard_normal(3) / np.sqrt(3.0)
        rotated = rotate(camera, axis, np.arctan(shift_px / camera.focal))
        bumped = replace(rotated, position=camera.position + shift_mm)
        if markers_visible(bumped, markers):
            break
    return bumped


def roll(camera: CameraModel, markers: Floats, angle: float) -> CameraModel:
    """Return the camera after a rotation of `angle` rad about its optical axis.

    If one of the `markers` (2, 3) mm would leave the image, the camera rotates about the line to
    their midpoint instead.
    """
    rolled = rotate(camera, np.array([0.0, 0.0, 1.0]), angle)
    if markers_visible(rolled, markers):
        return rolled
    return rotate(camera, camera.rotation @ (markers.mean(axis=0) - camera.position), angle)


def rotate(camera: CameraModel, axis: Floats, angle: float) -> CameraModel:
    """Return the camera after a rotation by `angle` rad about an `axis` (3,) in camera axes.

    Rodrigues' formula R = I + sin(angle) K + (1 − cos(angle)) K², with K x = axis × x.
    """
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    return replace(camera, rotation=R @ camera.rotation)


def markers_visible(camera: CameraModel, markers: Floats) -> bool:
    """Return True if both `markers` (2, 3) mm are in the image, away from its border."""
    pixels, size = camera.project(markers), np.array([camera.width, camera.height])
    inside = (pixels > BORDER_MARGIN_PX) & (pixels < size - BORDER_MARGIN_PX)
    return bool(inside.all())
