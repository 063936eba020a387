"""Disturbances of the camera's view: hidden, swapped, imitated and frozen markers, smoke, blood.

Rendered images show the disturbances. A camera without images loses the markers that they would
hide. The time of the exposure decides what a frame shows. The camera's own motions start here too;
camera_moves.py computes them.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats, Frame
from rcmservo.sim.cameras import PictureCamera, SimulatedCamera
from rcmservo.sim.disturbances.camera_moves import CAMERA_MOTION_KINDS
from rcmservo.sim.disturbances.decoy_markers import DecoyMarkers
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.disturbances.smoke_and_blood import Smoke, Stain, Veil
from rcmservo.sim.rendering import Appearance, Colour, Light, LightFilter

BLOOD_DROP_SIZE = 1.6, 45.0
"""Ratio of a blood drop's radius to the marker's, and a margin (px) that is added to it."""

NON_FINITE_POINTS = np.array([[np.nan, np.inf], [-np.inf, np.nan]])
"""Points (2, 2) px of a tracker whose numbers are not finite."""


class DisturbedView:
    """Camera with disturbances between scene and image.

    Parameters
    ----------
    camera : SimulatedCamera
        True camera.
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
        self.camera, self.look, self.schedule, self.move_camera = (
            camera,
            look,
            schedule,
            move_camera,
        )
        self.decoys = DecoyMarkers(camera, look, schedule)
        self._motion_done: dict[Event, float] = {}
        self._veils: dict[Event, Veil] = {}
        self._frozen_frames: dict[Event, Frame] = {}
        self._raw: Frame | None = None
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        time = self.camera.timing.newest(self.camera.arm.time)[1]
        self._move(time)
        if isinstance(self.camera, PictureCamera):
            self.camera.renderer.look = self._marker_look(time)
            self.camera.light_filter = self._draw_layers_at(time)
        raw = self.camera.latest()
        if raw is not self._raw:
            self._raw = raw
            self._frame = None if raw is None else self._disturbed_frame(raw, time)
        return self._frame

    def _move(self, time: int) -> None:
        """Move the camera itself to its pose at the exposure time (ns)."""
        for event in self.schedule.started(time, *CAMERA_MOTION_KINDS):
            done, duration = self._motion_done.get(event, 0.0), event.disturbance.duration_s * 1e9
            gradual = 0.0 < duration < np.inf
            fraction = (min(time, event.end) - event.start) / duration if gradual else 1.0
            if fraction > done:
                self._motion_done[event] = fraction
                self.move_camera(event, fraction - done)

    def _disturbed_frame(self, raw: Frame, time: int) -> Frame:
        """Return the frame that the camera delivers; a frozen image has fresh numbers and times."""
        frame = raw
        if raw.points is not None:
            frame = replace(raw, points=self._disturbed_points(raw.points, time))
        for event in self.schedule.active(time, "freeze"):
            if event.number("marker") == 0:
                frozen = self._frozen_frames.setdefault(event, frame)
                frame = replace(frame, image=frozen.image, points=frozen.points)
        return frame

    # ------------------------------------------------------------ images

    def _marker_look(self, time: int) -> Appearance:
        """Return the appearance of the markers: none if hidden, each other's if swapped."""
        radii, colours = list(self.look.marker_radii), list(self.look.marker_colours)
        if any(self.schedule.active(time, "swap")):
            radii.reverse()
            colours.reverse()
        for event in self._occlusions(time, "object"):
            for i in _marker_indices(event):
                radii[i] = 0.0
        for i, _ in self.decoys.positions_at(time):
            radii[i] = 0.0
        return replace(self.look, marker_radii=tuple(radii), marker_colours=tuple(colours))

    def _draw_layers_at(self, time: int) -> LightFilter | None:
        """Return a function that draws the disturbances over the light, None if there are none."""
        layers: list[LightFilter] = []
        for i, (u, v) in self.decoys.positions_at(time):
            radius = self.decoys.radius(time, i)
            layers.append(_ball_layer(u, v, radius, self.look.marker_colours[i]))
        for event in self._occlusions(time, "smoke", "blood"):
            layers.append(_veil_layer(self._veil(event, time), (time - event.start) * 1e-9))

        def draw_layers(light: Light) -> None:
            for layer in layers:
                layer(light)

        return draw_layers if layers else None

    # ------------------------------------------------------------ points

    def _disturbed_points(self, points: Floats, time: int) -> Floats:
        """Return the markers (2, 2) px as a tracker would find them."""
        points = points.copy()
        if any(self.schedule.active(time, "swap")):
            points = points[::-1].copy()
        for i, position in self.decoys.positions_at(time):
            noise = np.nan_to_num(points[i] - self.decoys.true_markers(time)[i])
            points[i] = position + noise if self.decoys.is_inside(position) else np.nan
        for event in self._occlusions(time, "smoke", "blood"):
            points[self._veil(event, time).hides(points, (time - event.start) * 1e-9)] = np.nan
        for event in self._occlusions(time, "object"):
            points[_marker_indices(event)] = np.nan
        return NON_FINITE_POINTS.copy() if any(self.schedule.active(time, "nan_points")) else points

    # ------------------------------------------------------------ positions

    def _occlusions(self, time: int, *by: str) -> Iterator[Event]:
        """Return the occlusions at `time` (ns) by one of these."""
        events = self.schedule.active(time, "occlusion")
        return (event for event in events if event.word("by") in by)

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.optics.width, self.camera.optics.height

    def _veil(self, event: Event, time: int) -> Veil:
        if event not in self._veils:
            lasts, markers = event.disturbance.duration_s, self.decoys.true_markers(time)
            if event.word("by") == "smoke":
                self._veils[event] = Smoke(self._size, lasts, markers.mean(axis=0), event.random)
            else:
                scale, margin = BLOOD_DROP_SIZE
                drops = [
                    [*markers[i], scale * self.decoys.radius(time, i) + margin] for i in range(2)
                ]
                self._veils[event] = Stain(self._size, lasts, np.array(drops), event.random)
        return self._veils[event]


def _marker_indices(event: Event) -> list[int]:
    """Return the indices of the markers that an event concerns."""
    marker = int(event.number("marker"))
    return [0, 1] if marker == 0 else [marker - 1]


def _veil_layer(veil: Veil, time: float) -> LightFilter:
    return lambda light: veil.paint(light, time)


def _ball_layer(u: float, v: float, radius: float, colour: Colour) -> LightFilter:
    """Return a layer that draws a ball lit from the camera: brighter in the middle, antialiased."""

    def paint(light: Light) -> None:
        height, width = light.shape[:2]
        columns, rows = np.arange(float(width)), np.arange(float(height))[:, None]
        distance = np.hypot(columns - u, rows - v)
        cover = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
        facing = np.sqrt(np.clip(1.0 - (distance / radius) ** 2, 0.0, 1.0))[..., None]
        light += (cover * ((0.35 + 0.65 * facing) * np.array(colour) - light)).astype(np.float32)

    return paint
