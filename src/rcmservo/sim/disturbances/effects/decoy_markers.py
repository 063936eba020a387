"""Decoys: objects that look like a marker while the true marker is hidden.

A decoy is at an offset from the true marker, in all frames or in every second one, and may slide
away. The decoy of a marker that freezes stays where the marker was in the image.
"""

from collections.abc import Iterator

import numpy as np

from rcmservo.interfaces import Floats
from rcmservo.sim.cameras import SimulatedCamera
from rcmservo.sim.disturbances.schedule import Event, Schedule
from rcmservo.sim.rendering import Appearance

DECOY_KINDS = "decoy", "freeze"
"""Kinds of disturbance that draw a decoy, except a freeze of the whole image."""

DECOY_MARGIN_PX = 20.0
"""Distance (px) of a decoy from the image border, if some direction permits it."""

SLIDE_HORIZON_S = 10.0
"""Time (s) of a slide for which the direction must keep the decoy in the image."""

DIRECTION_TRIALS = 16
"""Directions from which that of a decoy is chosen."""


class DecoyMarkers:
    """Decoys in the view of a camera.

    Times are those of exposures, ns.

    Parameters
    ----------
    camera : SimulatedCamera
        Camera that observes the tool.
    look : Appearance
        Undisturbed appearance of the tool.
    schedule : Schedule
        Disturbances with their times.
    """

    def __init__(self, camera: SimulatedCamera, look: Appearance, schedule: Schedule) -> None:
        self.camera, self.look, self.schedule = camera, look, schedule
        self._directions: dict[Event, Floats] = {}
        self._frozen_positions: dict[Event, Floats] = {}

    def positions_at(self, time: int) -> Iterator[tuple[int, Floats]]:
        """Yield the index of each hidden marker and the position (2,) px of its decoy."""
        for event in self.schedule.active(time, *DECOY_KINDS):
            i = int(event.number("marker")) - 1
            if i >= 0 and (event.kind == "freeze" or self._is_drawn(event, time)):
                yield i, self._compute_position(event, time, i)

    def true_markers(self, time: int) -> Floats:
        """Return the true images of the markers, (2, 2) px."""
        return self.camera.optics.project(self.camera.points_at(time)[:2])

    def radius(self, time: int, i: int) -> float:
        """Return the apparent radius (px) of marker `i`."""
        position, radius_mm = self.camera.points_at(time)[i], self.look.marker_radii[i]
        return self.camera.optics.silhouette_radius(position, radius_mm)

    def is_inside(self, position: Floats, margin: float = 0.0) -> bool:
        """Return True if a `position` (2,) px is in the image, `margin` px from its border."""
        size = np.array([self.camera.optics.width, self.camera.optics.height])
        return bool(((position >= margin) & (position <= size - 1.0 - margin)).all())

    def _compute_position(self, event: Event, time: int, i: int) -> Floats:
        """Return the position (2,) px of the decoy of marker `i`."""
        marker = self.true_markers(time)[i]
        if event.kind == "freeze":
            return self._frozen_positions.setdefault(event, marker)
        return marker + self._choose_direction(event, time, i) * _compute_offset_px(event, time)

    def _choose_direction(self, event: Event, time: int, i: int) -> Floats:
        """Return the unit vector (2,) towards a decoy, which stays in the image if possible."""
        if event not in self._directions:
            end_time = min(event.end, event.start + SLIDE_HORIZON_S * 1e9)
            angles = event.random.uniform(0.0, 2.0 * np.pi, DIRECTION_TRIALS)
            directions = np.column_stack([np.cos(angles), np.sin(angles)])
            offsets = _compute_offset_px(event, end_time) * directions
            margin = DECOY_MARGIN_PX + self.radius(time, i)
            positions = self.true_markers(time)[i] + offsets
            are_inside = [self.is_inside(position, margin) for position in positions]
            self._directions[event] = directions[int(np.argmax(are_inside))]
        return self._directions[event]

    def _is_drawn(self, event: Event, time: int) -> bool:
        """Return True if the frame exposed at `time` shows the decoy of an event."""
        period = int(event.number("every"))
        return round(time * 1e-9 * self.camera.timing.frame_rate) % period == period - 1


def _compute_offset_px(event: Event, time: float) -> float:
    """Return the distance (px) of a decoy from its marker."""
    return event.number("px") + event.number("speed") * (time - event.start) * 1e-9
