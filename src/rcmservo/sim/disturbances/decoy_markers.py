"""Things that look like a marker while the true one is hidden, and where they are seen: some way
off, in all frames or in every second one; sliding away; or where the marker was once."""

from collections.abc import Iterator

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.cameras import SimulatedCamera
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.rendering import Look

MIMICS = "decoy", "freeze"
"""The kinds that show a decoy. One that freezes the whole picture shows none."""

MARGIN = 20.0
"""px that a decoy keeps from the picture's border, if any direction lets it."""

FARTHEST = 10.0
"""s of a slide for which a direction is sought that keeps it in the picture."""


class DecoyMarkers:
    """Decoys in a camera's view, and their positions. Times are those of exposures, ns."""

    def __init__(self, camera: SimulatedCamera, look: Look, schedule: Schedule) -> None:
        self.camera, self.look, self.schedule = camera, look, schedule
        self._ways: dict[Event, Floats] = {}
        self._places: dict[Event, Floats] = {}

    def at(self, time: int) -> Iterator[tuple[int, Floats]]:
        """Which markers, from 0, are hidden, and where (2,) px something else is taken for each."""
        for event in self.schedule.acting(time, *MIMICS):
            i = int(event.number("marker")) - 1
            if i >= 0 and (event.kind == "freeze" or self._shows(event, time)):
                yield i, self._place(event, time, i)

    def true(self, time: int) -> Floats:
        """Return the true positions of the markers in the picture, (2, 2) px."""
        return self.camera.optics.project(self._markers(time))

    def radius(self, time: int, i: int) -> float:
        """Return the apparent radius of marker i, px."""
        return self.camera.optics.silhouette_radius(
            self._markers(time)[i], self.look.marker_radii[i]
        )

    def inside(self, place: Floats, margin: float = 0.0) -> bool:
        """Return True if a `place` (2,) px is in the picture, `margin` px from its border."""
        size = np.array([self.camera.optics.width, self.camera.optics.height])
        return bool(((place >= margin) & (place <= size - 1.0 - margin)).all())

    def _place(self, event: Event, time: int, i: int) -> Floats:
        if event.kind == "freeze":
            return self._places.setdefault(event, self.true(time)[i])
        return self.true(time)[i] + self._way(event, time, i) * self._far(event, time)

    def _far(self, event: Event, time: float) -> float:
        """Return the distance of a decoy from its marker at a moment, px."""
        return event.number("px") + event.number("speed") * (time - event.start) * 1e-9

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

    def _shows(self, event: Event, time: int) -> bool:
        """Return True if a decoy is in the frame exposed at `time`."""
        every = int(event.number("every"))
        return round(time * 1e-9 * self.camera.timing.frame_rate) % every == every - 1

    def _markers(self, time: int) -> Floats:
        """p₁ and p₂ (2, 3) mm at a moment (ns)."""
        return self.camera.points_at(time)[:2]
