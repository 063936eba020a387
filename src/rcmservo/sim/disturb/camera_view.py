"""What the camera sees when markers are lost, exchanged or mimicked, in smoke, with blood on its
lens, or moved.

In pictures such things are drawn. A camera that tells points loses the markers that would be
hidden. What is seen is decided by the moment of the exposure.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rcmservo.interfaces import Floats, Frame
from rcmservo.sim.cameras import PictureCamera, SimulatedCamera
from rcmservo.sim.disturb.schedule import Event, Schedule
from rcmservo.sim.disturb.smoke_and_blood import Smoke, Stain, Veil
from rcmservo.sim.rendering import Between, Colour, Light, Look

MOVES = "bump", "roll", "relocate"

MARGIN = 20.0
"""px that a false marker keeps from the picture's border, if any direction lets it."""

DROP = 1.6, 45.0
"""A drop of blood on a marker is so many times as large, and by so many px larger."""

BROKEN = np.array([[np.nan, np.inf], [-np.inf, np.nan]])
"""Points (2, 2) px of a tracker that is broken."""


class View:
    """A camera before whose lens things happen. `moved` is called when the camera itself is
    moved."""

    def __init__(
        self,
        camera: SimulatedCamera,
        look: Look,
        schedule: Schedule,
        moved: Callable[[Event], None],
    ) -> None:
        self.camera, self.look, self.schedule, self.moved = camera, look, schedule, moved
        self._done: set[Event] = set()
        self._veils: dict[Event, Veil] = {}
        self._offsets: dict[Event, Floats] = {}
        self._raw: Frame | None = None
        self._frame: Frame | None = None

    def latest(self) -> Frame | None:
        time = self.camera.timing.newest(self.camera.arm.time)[1]
        for event in self.schedule.begun(time, *MOVES):
            if event not in self._done:
                self._done.add(event)
                self.moved(event)
        if isinstance(self.camera, PictureCamera):
            self.camera.renderer.look = self._worn(time)
            self.camera.between = self._between(time)
        raw = self.camera.latest()
        if raw is not self._raw:
            self._raw = raw
            self._frame = raw
            if raw is not None and raw.points is not None:
                self._frame = replace(raw, points=self._points(raw.points, time))
        return self._frame

    # ------------------------------------------------------------ pictures

    def _worn(self, time: int) -> Look:
        """How the markers look: none where lost or hidden, each like the other where swapped."""
        radii, colours = list(self.look.marker_radii), list(self.look.marker_colours)
        if any(self.schedule.acting(time, "swap")):
            radii.reverse()
            colours.reverse()
        for event in self.schedule.acting(time, "marker_loss", "false_marker"):
            for i in _which(event):
                radii[i] = 0.0
        return replace(self.look, marker_radii=tuple(radii), marker_colours=tuple(colours))

    def _between(self, time: int) -> Between | None:
        """What stands between the scene and the sensor."""
        layers: list[Between] = []
        for event in self.schedule.acting(time, "false_marker"):
            i = int(event.number("marker")) - 1
            u, v = self._seen(time)[i] + self._offset(event, time, i)
            layers.append(_ball(u, v, self._radius(time, i), self.look.marker_colours[i]))
        for event in self.schedule.acting(time, "smoke", "stain"):
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
        for event in self.schedule.acting(time, "false_marker"):
            for i in _which(event):
                points[i] += self._offset(event, time, i)
        for event in self.schedule.acting(time, "smoke", "stain"):
            points[self._veil(event, time).hides(points, (time - event.start) * 1e-9)] = np.nan
        for event in self.schedule.acting(time, "marker_loss"):
            points[_which(event)] = np.nan
        return BROKEN.copy() if any(self.schedule.acting(time, "nan_points")) else points

    # ------------------------------------------------------------ where things are

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.optics.width, self.camera.optics.height

    def _markers(self, time: int) -> Floats:
        """p₁ and p₂ (2, 3) mm at a moment (ns)."""
        return self.camera.points_at(time)[:2]

    def _seen(self, time: int) -> Floats:
        """Where the markers truly are in the picture, (2, 2) px."""
        return self.camera.optics.project(self._markers(time))

    def _radius(self, time: int, i: int) -> float:
        return self.camera.optics.silhouette_radius(
            self._markers(time)[i], self.look.marker_radii[i]
        )

    def _veil(self, event: Event, time: int) -> Veil:
        if event not in self._veils:
            lasts, seen = event.disturbance.lasts, self._seen(time)
            if event.kind == "smoke":
                self._veils[event] = Smoke(self._size, lasts, seen.mean(axis=0), event.random)
            else:
                larger, by = DROP
                drops = [[*seen[i], larger * self._radius(time, i) + by] for i in range(2)]
                self._veils[event] = Stain(self._size, lasts, np.array(drops), event.random)
        return self._veils[event]

    def _offset(self, event: Event, time: int, i: int) -> Floats:
        """How far from the true marker i the false one appears, (2,) px.

        It appears within the picture if that can be.
        """
        if event not in self._offsets:
            margin = MARGIN + self._radius(time, i)
            ways = event.random.uniform(0.0, 2.0 * np.pi, 16)
            offsets = event.number("px") * np.column_stack([np.cos(ways), np.sin(ways)])
            there = self._seen(time)[i] + offsets
            inside = ((there > margin) & (there < np.array(self._size) - margin)).all(axis=1)
            self._offsets[event] = offsets[int(np.argmax(inside))]
        return self._offsets[event]


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
