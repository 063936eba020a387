"""Things that look like a marker while the true one is hidden, and where they are seen: some way
off, in all frames or in every second one; sliding away; or where the marker was once."""

from collections.abc import Iterator

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.cameras import SimulatedCamera
from rcmservo.sim.disturb.schedule import Event, Schedule
from rcmservo.sim.rendering import Look

MIMICS = "false_marker", "flicker", "slide", "freeze"
"""The kinds that show a likeness. One that freezes the whole picture shows none."""

MARGIN = 20.0
"""px that a likeness keeps from the picture's border, if any direction lets it."""

FARTHEST = 10.0
"""s of a slide for which a direction is sought that keeps it in the picture."""


class Likenesses:
    """Where a camera sees what is not a marker. Times are those of exposures, ns."""

    def __init__(self, camera: SimulatedCamera, look: Look, schedule: Schedule) -> None:
        self.camera, self.look, self.schedule = camera, look, schedule
        self._ways: dict[Event, Floats] = {}
        self._places: dict[Event, Floats] = {}

    def at(self, time: int) -> Iterator[tuple[int, Floats]]:
        """Which markers, from 0, are hidden, and where (2,) px something else is taken for each."""
        for event in self.schedule.acting(time, *MIMICS):
            i = int(event.number("marker")) - 1
            if i >= 0 and (event.kind != "flicker" or self._odd(time)):
                yield i, self._place(event, time, i)

    def true(self, time: int) -> Floats:
        """Where the markers truly are in the picture, (2, 2) px."""
        return self.camera.optics.project(self._markers(time))

    def radius(self, time: int, i: int) -> float:
        """How large marker i is in the picture, px."""
        return self.camera.optics.silhouette_radius(
            self._markers(time)[i], self.look.marker_radii[i]
        )

    def inside(self, place: Floats, margin: float = 0.0) -> bool:
        """Whether a `place` (2,) px is in the picture, `margin` px from its border."""
        size = np.array([self.camera.optics.width, self.camera.optics.height])
        return bool(((place >= margin) & (place <= size - 1.0 - margin)).all())

    def _place(self, event: Event, time: int, i: int) -> Floats:
        if event.kind == "freeze":
            return self._places.setdefault(event, self.true(time)[i])
        return self.true(time)[i] + self._way(event, time, i) * self._far(event, time)

    def _far(self, event: Event, time: float) -> float:
        """How far off a likeness is at a moment, px."""
        if event.kind == "slide":
            return event.number("speed") * (time - event.start) * 1e-9
        return event.number("px")

    def _way(self, event: Event, time: int, i: int) -> Floats:
        """In which direction, a unit vector (2,): within the picture if that can be."""
        if event not in self._ways:
            far = self._far(event, min(event.end, event.start + FARTHEST * 1e9))
            ways = event.random.uniform(0.0, 2.0 * np.pi, 16)
            units = np.column_stack([np.cos(ways), np.sin(ways)])
            there, margin = self.true(time)[i] + far * units, MARGIN + self.radius(time, i)
            inside = [self.inside(place, margin) for place in there]
            self._ways[event] = units[int(np.argmax(inside))]
        return self._ways[event]

    def _odd(self, time: int) -> bool:
        return round(time * 1e-9 * self.camera.timing.frame_rate) % 2 == 1

    def _markers(self, time: int) -> Floats:
        """p₁ and p₂ (2, 3) mm at a moment (ns)."""
        return self.camera.points_at(time)[:2]
