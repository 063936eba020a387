"""The first motion, from nothing: visit the corners of a small tetrahedron around the start, until
Ĵ predicts.

Neither â = 0 nor Ĵ = 0 can be inverted, and coplanar positions leave the projection undetermined
(rank 8), so the policy asks for yaw, pitch and insertion together. It ends when the estimate
predicts the feature changes between the corners that were seen, and says so when it does not after
the time allowed.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.method.features import SCALE, about, difference, features
from rcmservo.method.kinematics import Rcm, axis, joints, position

CORNERS = np.array(
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
) / np.sqrt(3.0)
LIMIT_MARGIN = 0.02
"""Share of each joint's range that the corners keep from its ends."""


@compiled
def corners(rcm: Rcm, q: Floats, radius: float, shape: Floats) -> Floats:
    """Four positions p₁ (4, 3) mm on a sphere about the present one, moved inside the joint
    limits."""
    lower, upper = np.array(rcm.lower), np.array(rcm.upper)
    n = axis(rcm, q)
    helper = np.zeros(3)
    helper[np.argmin(np.abs(n))] = 1.0
    t1 = np.cross(n, helper)
    t1 /= np.sqrt(np.sum(t1**2))
    t2 = np.cross(n, t1)
    start = position(rcm, q)
    margin = LIMIT_MARGIN * (upper - lower)
    places = np.empty((4, 3))
    for i in range(4):
        p = start + radius * (shape[i, 0] * t1 + shape[i, 1] * t2 + shape[i, 2] * n)
        near = joints(rcm, p)
        near[:2] += 2.0 * np.pi * np.round((q[:2] - near[:2]) / (2.0 * np.pi))
        inside = np.minimum(np.maximum(near, lower + margin), upper - margin)
        places[i] = position(rcm, inside)
    return places


@compiled
def volume(places: Floats) -> float:
    """Volume (mm³) of the tetrahedron with these corners (4, 3)."""
    a, b, c = places[1] - places[0], places[2] - places[0], places[3] - places[0]
    return abs(np.sum(a * np.cross(b, c))) / 6.0


@compiled
def towards(p1: Floats, goal: Floats, speed: float, reach: float) -> Floats:
    """Velocity (3,) mm/s from p1 to the goal at `speed`, slower within twice `reach` of it."""
    way = goal - p1
    distance = np.sqrt(np.sum(way**2))
    return way / max(distance, 1e-9) * speed * min(distance / (2.0 * reach), 1.0)


@compiled
def unexplained(seen: Floats, J_hat: Floats, o_c: Floats) -> float:
    """Share of the feature changes between successive rows [p₁, raw m₁ m₂] (n, 7) that Ĵ Δp₁ leaves
    open, scaled."""
    left, total = 0.0, 0.0
    y = features(about(seen[0, 3:].copy(), o_c))
    for i in range(1, len(seen)):
        y_next = features(about(seen[i, 3:].copy(), o_c))
        change = difference(y_next, y)
        left += np.sum(((change - J_hat @ (seen[i, :3] - seen[i - 1, :3])) / SCALE) ** 2)
        total += np.sum((change / SCALE) ** 2)
        y = y_next
    return np.sqrt(left / total) if total > 0.0 else np.inf


class Exploring(NamedTuple):
    """Where an exploration stands: its ``corners``, the ``visits`` so far, ``seen`` rows at each,
    the ``start`` ns."""

    corners: Floats
    seen: Floats
    visits: int
    start: int


@dataclass(frozen=True)
class Exploration:
    """How the tool moves while nothing is known yet."""

    radius: float = 7.0
    """How far the tool leaves its start, mm."""
    speed: float = 35.0
    """Speed on the way, mm/s."""
    tolerance: float = 0.3
    """Share of the observed feature changes that a good enough estimate may leave unexplained, 0 to
    1."""
    max_time: float = 10.0
    """Time after which exploration is given up, s."""
    reach: float = 1.0
    """How near to a corner of the tour counts as being there, mm."""
    rounds: int = 1
    """Least number of tours round the four corners."""

    def __post_init__(self) -> None:
        for name in ("radius", "speed", "tolerance", "max_time", "reach"):
            value = getattr(self, name)
            require(0.0 < value < np.inf, f"exploration.{name}", value, "a positive number")
        require(1 <= self.rounds <= 1000, "exploration.rounds", self.rounds, "from 1 to 1000")

    def begin(self, rcm: Rcm, q: Floats, now: int) -> Exploring | None:
        """The tour from the configuration q (3,), or None where the joint limits leave too little
        room around it."""
        full = volume(self.radius * CORNERS)
        for shape in (CORNERS, -CORNERS):
            places = corners(rcm, q, self.radius, shape)
            if volume(places) > 0.2 * full:
                return Exploring(places, np.zeros((4, 7)), 0, now)
        return None

    def velocity(self, tour: Exploring, p1: Floats) -> Floats:
        """v (3,) mm/s for marker 1 at p1."""
        return towards(p1, tour.corners[tour.visits % 4], self.speed, self.reach)

    def arrived(self, tour: Exploring, p1: Floats) -> bool:
        """Whether the present corner is reached."""
        return math.dist(p1, tour.corners[tour.visits % 4]) < self.reach

    def visit(self, tour: Exploring, p1: Floats, points: Floats) -> Exploring:
        """The tour after what was seen at a corner: p1 (3,) mm and raw points (2, 2) px of one
        frame."""
        seen = np.roll(tour.seen, -1, axis=0)
        seen[-1, :3], seen[-1, 3:] = p1, points.reshape(4)
        return tour._replace(seen=seen, visits=tour.visits + 1)

    def complete(self, tour: Exploring, J_hat: Floats, o_c: Floats) -> bool:
        """Whether all corners were seen and Ĵ explains what was seen there."""
        toured = tour.visits >= 4 * self.rounds
        return toured and bool(unexplained(tour.seen, J_hat, o_c) <= self.tolerance)

    def overdue(self, tour: Exploring, now: int) -> bool:
        """Whether the time allowed is used up."""
        return now - tour.start > self.max_time * 1e9
