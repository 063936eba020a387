"""Disturbances of the camera's view: hidden, swapped, imitated and frozen markers, smoke, blood.

They act between the scene and the image, at the time of the exposure. Rendered images show them. A
camera without images loses the markers that they would hide. This module also starts the camera's
own motions, which camera_moves.py computes.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from rcmservo.interfaces import Floats, Frame
from rcmservo.sim.cameras import PictureCamera, SimulatedCamera
from rcmservo.sim.disturbances.effects.camera_moves import CAMERA_MOTION_KINDS
from rcmservo.sim.disturbances.effects.decoy_markers import DecoyMarkers
from rcmservo.sim.disturbances.effects.smoke_and_blood import BloodStain, Smoke, Veil
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.rendering import Appearance, Colour, Light, LightFilter

BLOOD_DROP_RATIO = 1.6
"""Ratio of a blood drop's radius to that of the marker that it covers."""

BLOOD_DROP_MARGIN_PX = 45.0
"""Length (px) that is added to the radius of a blood drop."""

NON_FINITE_POINTS = np.array([[np.nan, np.inf], [-np.inf, np.nan]])
"""Points (2, 2) px that a faulty tracker reports."""


class DisturbedView:
    """Camera whose view is disturbed as a schedule says.

    Parameters
    ----------
    camera : SimulatedCamera
        Undisturbed camera.
    look : Appearance
        Undisturbed appearance of the tool.
    schedule : Schedule
        Disturbances with their times.
    move_camera : callable
        Moves the camera itself by a fraction of an event's motion since the previous call.
    """

    def __init__(
        self,
        camera: SimulatedCamera,
        look: Appearance,
        schedule: Schedule,
        move_camera: Callable[[Event, float], None],
    ) -> None:
        self.camera, self.look = camera, look
        self.schedule, self.move_camera = schedule, move_camera
        self.decoys = DecoyMarkers(camera, look, schedule)
        self._motion_fractions: dict[Event, float] = {}
        self._veils: dict[Event, Veil] = {}
        self._frozen_frames: dict[Event, Frame] = {}
        self._undisturbed_frame: Frame | None = None
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        """Return the newest frame, disturbed; None before the first one."""
        time = self.camera.timing.newest(self.camera.arm.time)[1]
        self._move_camera_until(time)
        if isinstance(self.camera, PictureCamera):
            self.camera.renderer.look = self._get_marker_look(time)
            self.camera.light_filter = self._make_light_filter(time)
        frame = self.camera.latest()
        if frame is not self._undisturbed_frame:
            self._undisturbed_frame = frame
            self._frame = None if frame is None else self._disturb_frame(frame, time)
        return self._frame

    def _move_camera_until(self, time: int) -> None:
        """Move the camera itself to its pose at the exposure time (ns)."""
        for event in self.schedule.started(time, *CAMERA_MOTION_KINDS):
            duration_ns = event.disturbance.duration_s * 1e9
            is_gradual = 0.0 < duration_ns < np.inf
            fraction = (min(time, event.end) - event.start) / duration_ns if is_gradual else 1.0
            previous_fraction = self._motion_fractions.get(event, 0.0)
            if fraction > previous_fraction:
                self._motion_fractions[event] = fraction
                self.move_camera(event, fraction - previous_fraction)

    def _disturb_frame(self, frame: Frame, time: int) -> Frame:
        """Return the frame that the camera delivers; a frozen image has fresh numbers and times."""
        if frame.points is not None:
            frame = replace(frame, points=self._disturb_points(frame.points, time))
        for event in self.schedule.active(time, "freeze"):
            if event.number("marker") == 0:
                frozen = self._frozen_frames.setdefault(event, frame)
                frame = replace(frame, image=frozen.image, points=frozen.points)
        return frame

    def _get_marker_look(self, time: int) -> Appearance:
        """Return the appearance of the tool, with its markers swapped or hidden."""
        radii, colours = list(self.look.marker_radii), list(self.look.marker_colours)
        if any(self.schedule.active(time, "swap")):
            radii.reverse()
            colours.reverse()
        for event in self._find_occlusions(time, "object"):
            for i in _marker_indices(event):
                radii[i] = 0.0
        for i, _ in self.decoys.positions_at(time):
            radii[i] = 0.0
        return replace(self.look, marker_radii=tuple(radii), marker_colours=tuple(colours))

    def _make_light_filter(self, time: int) -> LightFilter | None:
        """Return a function that draws decoys, smoke and blood over the light; None without any."""
        layers: list[LightFilter] = []
        for i, centre in self.decoys.positions_at(time):
            radius, colour = self.decoys.radius(time, i), self.look.marker_colours[i]
            layers.append(partial(_paint_ball, centre=centre, radius=radius, colour=colour))
        for event in self._find_occlusions(time, "smoke", "blood"):
            veil = self._get_veil(event, time)
            layers.append(partial(veil.paint, time=(time - event.start) * 1e-9))

        def paint_layers(light: Light) -> None:
            for paint in layers:
                paint(light)

        return paint_layers if layers else None

    def _disturb_points(self, points: Floats, time: int) -> Floats:
        """Return the markers (2, 2) px as a tracker would find them in a disturbed image."""
        is_swapped = any(self.schedule.active(time, "swap"))
        points = points[::-1].copy() if is_swapped else points.copy()
        for i, position in self.decoys.positions_at(time):
            noise = np.nan_to_num(points[i] - self.decoys.true_markers(time)[i])
            points[i] = position + noise if self.decoys.is_inside(position) else np.nan
        for event in self._find_occlusions(time, "smoke", "blood"):
            veil = self._get_veil(event, time)
            points[veil.hides(points, (time - event.start) * 1e-9)] = np.nan
        for event in self._find_occlusions(time, "object"):
            points[_marker_indices(event)] = np.nan
        return NON_FINITE_POINTS.copy() if any(self.schedule.active(time, "nan_points")) else points

    def _find_occlusions(self, time: int, *by: str) -> Iterator[Event]:
        """Return the occlusions at `time` (ns) whose parameter `by` is one of these words."""
        events = self.schedule.active(time, "occlusion")
        return (event for event in events if event.word("by") in by)

    def _get_veil(self, event: Event, time: int) -> Veil:
        """Return the smoke or blood of an event, which is made where it is first visible."""
        if event not in self._veils:
            size = self.camera.optics.width, self.camera.optics.height
            duration_s, markers = event.disturbance.duration_s, self.decoys.true_markers(time)
            if event.word("by") == "smoke":
                veil: Veil = Smoke(size, duration_s, markers.mean(axis=0), event.random)
            else:
                marker_radii = np.array([self.decoys.radius(time, i) for i in range(2)])
                drop_radii = BLOOD_DROP_RATIO * marker_radii + BLOOD_DROP_MARGIN_PX
                drops = np.column_stack([markers, drop_radii])
                veil = BloodStain(size, duration_s, drops, event.random)
            self._veils[event] = veil
        return self._veils[event]


def _marker_indices(event: Event) -> list[int]:
    """Return the indices of the markers that an event concerns."""
    marker = int(event.number("marker"))
    return [0, 1] if marker == 0 else [marker - 1]


def _paint_ball(light: Light, centre: Floats, radius: float, colour: Colour) -> None:
    """Draw a ball over the light, lit from the camera: brighter in the middle, antialiased."""
    height, width = light.shape[:2]
    columns, rows = np.arange(float(width)), np.arange(float(height))[:, None]
    distance = np.hypot(columns - centre[0], rows - centre[1])
    coverage = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
    cosine = np.sqrt(np.clip(1.0 - (distance / radius) ** 2, 0.0, 1.0))[..., None]
    light += (coverage * ((0.35 + 0.65 * cosine) * np.array(colour) - light)).astype(np.float32)
