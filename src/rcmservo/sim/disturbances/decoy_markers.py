"""Objects that look like a marker while the true one is hidden, and their positions in the image.

A decoy is at an offset from the true marker, in all frames or in every second one, and may slide
away; or it stays where the marker was.
"""

from collections.abc import Iterator

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.cameras import SimulatedCamera
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.rendering import Appearance

DECOY_KINDS = "decoy", "freeze"
"""Kinds that draw a decoy. One that freezes the whole image draws none."""

DECOY_MARGIN_PX = 20.0
"""Distance (px) of a decoy from the image border, if some direction permits it."""

SLIDE_HORIZON_S = 10.0
"""Time (s) of a slide for which the direction must keep the decoy in the image."""


class DecoyMarkers:
    """Decoys in a camera's view and their positions. Times are those of exposures, ns."""

    def __init__(self, camera: SimulatedCamera, look: Appearance, schedule: Schedule) -> None:
        self.camera, self.look, self.schedule = camera, look, schedule
        self._directions: dict[Event, Floats] = {}
        self._frozen_positions: dict[Event, Floats] = {}

    def positions_at(self, time: int) -> Iterator[tuple[int, Floats]]:
        """Yield the index of each hidden marker and the position (2,) px of its decoy."""
        for event in self.schedule.active(time, *DECOY_KINDS):
            i = int(event.number("marker")) - 1
            if i >= 0 and (event.kind == "freeze" or self._is_drawn(event, time)):
                yield i, self._decoy_position(event, time, i)

    def true_markers(self, time: int) -> Floats:
        """Return the true images of the markers, (2, 2) px."""
        return self.camera.optics.project(self._marker_positions(time))

    def radius(self, time: int, i: int) -> float:
        """Return the apparent radius (px) of marker `i`."""
        return self.camera.optics.silhouette_radius(
            self._marker_positions(time)[i], self.look.marker_radii[i]
        )

    def is_inside(self, position: Floats, margin: float = 0.0) -> bool:
        """Return True if a `position` (2,) px is in the image, `margin` px from its border."""
        size = np.array([self.camera.optics.width, self.camera.optics.height])
        return bool(((position >= margin) & (position <= size - 1.0 - margin)).all())

    def _decoy_position(self, event: Event, time: int, i: int) -> Floats:
        if event.kind == "freeze":
            return self._frozen_positions.setdefault(event, self.true_markers(time)[i])
        return self.true_markers(time)[i] + self._direction(event, time, i) * self._offset_px(
            event, time
        )

    def _offset_px(self, event: Event, time: float) -> float:
        """Return the distance (px) of a decoy from its marker."""
        return event.number("px") + event.number("speed") * (time - event.start) * 1e-9

    def _direction(self, event: Event, time: int, i: int) -> Floats:
        """Return the unit vector (2,) towards a decoy, which stays in the image if possible."""
        if event not in self._directions:
            offset = self._offset_px(event, min(event.end, event.start + SLIDE_HORIZON_S * 1e9))
            angles = event.random.uniform(0.0, 2.0 * np.pi, 16)
            units = np.column_stack([np.cos(angles), np.sin(angles)])
            positions, margin = (
                self.true_markers(time)[i] + offset * units,
                DECOY_MARGIN_PX + self.radius(time, i),
            )
            fits = [self.is_inside(position, margin) for position in positions]
            self._directions[event] = units[int(np.argmax(fits))]
        return self._directions[event]

    def _is_drawn(self, event: Event, time: int) -> bool:
        """Return True if the frame exposed at `time` shows a decoy."""
        every = int(event.number("every"))
        return round(time * 1e-9 * self.camera.timing.frame_rate) % every == every - 1

    def _marker_positions(self, time: int) -> Floats:
        """Return p₁ and p₂ (2, 3) mm at a time (ns)."""
        return self.camera.points_at(time)[:2]
