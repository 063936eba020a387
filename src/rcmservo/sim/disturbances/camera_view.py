"""The camera's view when markers are hidden, exchanged or imitated, in smoke, with blood on its
lens, when it is moved, or shows the same picture for ever.

In pictures such things are drawn. A camera that tells points loses the markers that would be
hidden. What is seen is decided by the moment of the exposure.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats, Frame
from rcmservo.sim.cameras import PictureCamera, SimulatedCamera
from rcmservo.sim.disturbances.camera_moves import MOVES
from rcmservo.sim.disturbances.decoy_markers import DecoyMarkers
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.disturbances.smoke_and_blood import Smoke, Stain, Veil
from rcmservo.sim.rendering import Between, Colour, Light, Look

DROP = 1.6, 45.0
"""A drop of blood on a marker is so many times as large, and by so many px larger."""

BROKEN = np.array([[np.nan, np.inf], [-np.inf, np.nan]])
"""Points (2, 2) px of a tracker that is broken."""


class View:
    """A camera before whose lens things happen. `moved` is called when the camera itself is moved,
    with the part of the event's motion that was made since it was called last."""

    def __init__(
        self,
        camera: SimulatedCamera,
        look: Look,
        schedule: Schedule,
        moved: Callable[[Event, float], None],
    ) -> None:
        self.camera, self.look, self.schedule, self.moved = camera, look, schedule, moved
        self.decoys = DecoyMarkers(camera, look, schedule)
        self._moved: dict[Event, float] = {}
        self._veils: dict[Event, Veil] = {}
        self._stills: dict[Event, Frame] = {}
        self._raw: Frame | None = None
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        time = self.camera.timing.newest(self.camera.arm.time)[1]
        self._move(time)
        if isinstance(self.camera, PictureCamera):
            self.camera.renderer.look = self._worn(time)
            self.camera.between = self._between(time)
        raw = self.camera.latest()
        if raw is not self._raw:
            self._raw = raw
            self._frame = None if raw is None else self._seen_in(raw, time)
        return self._frame

    def _move(self, time: int) -> None:
        """Move the camera itself as far as it has been by the exposure at `time` ns."""
        for event in self.schedule.begun(time, *MOVES):
            before, takes = self._moved.get(event, 0.0), event.disturbance.lasts * 1e9
            slowly = 0.0 < takes < np.inf
            now = (min(time, event.end) - event.start) / takes if slowly else 1.0
            if now > before:
                self._moved[event] = now
                self.moved(event, now - before)

    def _seen_in(self, raw: Frame, time: int) -> Frame:
        """The frame that the camera gives: of a picture that is frozen, the numbers are fresh."""
        frame = raw
        if raw.points is not None:
            frame = replace(raw, points=self._points(raw.points, time))
        for event in self.schedule.acting(time, "freeze"):
            if event.number("marker") == 0:
                still = self._stills.setdefault(event, frame)
                frame = replace(frame, image=still.image, points=still.points)
        return frame

    # ------------------------------------------------------------ pictures

    def _worn(self, time: int) -> Look:
        """Look of the markers: none where hidden, each like the other where swapped."""
        radii, colours = list(self.look.marker_radii), list(self.look.marker_colours)
        if any(self.schedule.acting(time, "swap")):
            radii.reverse()
            colours.reverse()
        for event in self._occluding(time, "object"):
            for i in _which(event):
                radii[i] = 0.0
        for i, _ in self.decoys.at(time):
            radii[i] = 0.0
        return replace(self.look, marker_radii=tuple(radii), marker_colours=tuple(colours))

    def _between(self, time: int) -> Between | None:
        """Return the layers between the scene and the sensor, None where there are none."""
        layers: list[Between] = []
        for i, (u, v) in self.decoys.at(time):
            radius = self.decoys.radius(time, i)
            layers.append(_ball(u, v, radius, self.look.marker_colours[i]))
        for event in self._occluding(time, "smoke", "blood"):
            layers.append(_laid(self._veil(event, time), (time - event.start) * 1e-9))

        def between(light: Light) -> None:
            for layer in layers:
                layer(light)

        return between if layers else None

    # ------------------------------------------------------------ points

    def _points(self, points: Floats, time: int) -> Floats:
        """The markers (2, 2) px as a tracker would find them."""
        points = points.copy()
        if any(self.schedule.acting(time, "swap")):
            points = points[::-1].copy()
        for i, there in self.decoys.at(time):
            noise = np.nan_to_num(points[i] - self.decoys.true(time)[i])
            points[i] = there + noise if self.decoys.inside(there) else np.nan
        for event in self._occluding(time, "smoke", "blood"):
            points[self._veil(event, time).hides(points, (time - event.start) * 1e-9)] = np.nan
        for event in self._occluding(time, "object"):
            points[_which(event)] = np.nan
        return BROKEN.copy() if any(self.schedule.acting(time, "nan_points")) else points

    # ------------------------------------------------------------ where things are

    def _occluding(self, time: int, *by: str) -> Iterator[Event]:
        """Return the occlusions at `time` ns by one of these."""
        events = self.schedule.acting(time, "occlusion")
        return (event for event in events if event.word("by") in by)

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.optics.width, self.camera.optics.height

    def _veil(self, event: Event, time: int) -> Veil:
        if event not in self._veils:
            lasts, seen = event.disturbance.lasts, self.decoys.true(time)
            if event.word("by") == "smoke":
                self._veils[event] = Smoke(self._size, lasts, seen.mean(axis=0), event.random)
            else:
                larger, by = DROP
                drops = [[*seen[i], larger * self.decoys.radius(time, i) + by] for i in range(2)]
                self._veils[event] = Stain(self._size, lasts, np.array(drops), event.random)
        return self._veils[event]


def _which(event: Event) -> list[int]:
    """Which markers an event concerns, from 0."""
    marker = int(event.number("marker"))
    return [0, 1] if marker == 0 else [marker - 1]


def _laid(veil: Veil, time: float) -> Between:
    return lambda light: veil.paint(light, time)


def _ball(u: float, v: float, radius: float, colour: Colour) -> Between:
    """Paints a ball that is lit from the camera: brighter in the middle, its edge a pixel wide."""

    def paint(light: Light) -> None:
        height, width = light.shape[:2]
        columns, rows = np.arange(float(width)), np.arange(float(height))[:, None]
        distance = np.hypot(columns - u, rows - v)
        cover = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
        facing = np.sqrt(np.clip(1.0 - (distance / radius) ** 2, 0.0, 1.0))[..., None]
        light += (cover * ((0.35 + 0.65 * facing) * np.array(colour) - light)).astype(np.float32)

    return paint
