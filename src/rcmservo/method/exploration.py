"""The first motion, from nothing: visit the corners of a small tetrahedron around the start, until
Ĵ predicts.

Neither â = 0 nor Ĵ = 0 can be inverted, and coplanar positions leave the projection undetermined
(rank 8), so the policy asks for yaw, pitch and insertion together. It ends when the estimate
predicts the feature changes between the corners that were seen, and says so when it does not after
the time allowed.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rcmservo.compiled import compiled
from rcmservo.errors import require
from rcmservo.interfaces import Floats
from rcmservo.loops import length, minus, product, put
from rcmservo.method.features import SCALE, about, difference, features
from rcmservo.method.kinematics import Rcm, axis, joints, position
from rcmservo.rows import Row, Rows, as_row, flag, reals, whole

CORNERS = np.array(
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
) / np.sqrt(3.0)
MIRRORED = -CORNERS
ROUNDING = 1e-9
"""Share by which the volume of a tour with all its room may differ from it."""

LIMIT_MARGIN = 0.02
"""Share of each joint's range that the corners keep from its ends."""


@compiled
def cross(a: Floats, b: Floats) -> Floats:
    """a × b (3,)."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@compiled
def right_angle(n: Floats) -> Floats:
    """A unit vector (3,) at right angles to n (3,)."""
    helper, least = np.zeros(3), 0
    for k in range(3):
        if abs(n[k]) < abs(n[least]):
            least = k
    helper[least] = 1.0
    across = cross(n, helper)
    size = length(across)
    return np.array([across[0] / size, across[1] / size, across[2] / size])


@compiled
def corners(rcm: Rcm, q: Floats, radius: float, shape: Floats) -> Floats:
    """Four positions p₁ (4, 3) mm on a sphere about the present one, moved inside the joint
    limits."""
    n, start, p, places = axis(rcm, q), position(rcm, q), np.empty(3), np.empty((4, 3))
    t1 = right_angle(n)
    t2 = cross(n, t1)
    for i in range(4):
        for k in range(3):
            way = shape[i, 0] * t1[k] + shape[i, 1] * t2[k] + shape[i, 2] * n[k]
            p[k] = start[k] + radius * way
        near = joints(rcm, p)
        for k in range(3):
            if k < 2:
                near[k] += 2.0 * np.pi * np.round((q[k] - near[k]) / (2.0 * np.pi))
            margin = LIMIT_MARGIN * (rcm.upper[k] - rcm.lower[k])
            near[k] = min(max(near[k], rcm.lower[k] + margin), rcm.upper[k] - margin)
        put(places[i], position(rcm, near))
    return places


@compiled
def volume(places: Floats) -> float:
    """Volume (mm³) of the tetrahedron with these corners (4, 3)."""
    a, b = minus(places[1], places[0]), minus(places[2], places[0])
    normal, c = cross(a, b), minus(places[3], places[0])
    return abs(normal[0] * c[0] + normal[1] * c[1] + normal[2] * c[2]) / 6.0


@compiled
def towards(p1: Floats, goal: Floats, speed: float, reach: float) -> Floats:
    """Velocity (3,) mm/s from p1 to the goal at `speed`, slower within twice `reach` of it."""
    way = minus(goal, p1)
    distance = length(way)
    share = speed / max(distance, 1e-9) * min(distance / (2.0 * reach), 1.0)
    return np.array([way[0] * share, way[1] * share, way[2] * share])


@compiled
def unexplained(seen: Floats, J_hat: Floats, o_c: Floats) -> float:
    """Share of the feature changes between successive rows [p₁, raw m₁ m₂] (n, 7) that Ĵ Δp₁ leaves
    open, scaled."""
    left, total = 0.0, 0.0
    y = features(about(seen[0, 3:], o_c))
    for i in range(1, len(seen)):
        y_next = features(about(seen[i, 3:], o_c))
        change = difference(y_next, y)
        foretold = product(J_hat, minus(seen[i, :3], seen[i - 1, :3]))
        for k in range(len(change)):
            left += ((change[k] - foretold[k]) / SCALE[k]) ** 2
            total += (change[k] / SCALE[k]) ** 2
        y = y_next
    return np.sqrt(left / total) if total > 0.0 else np.inf


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

    @cached_property
    def row(self) -> "Rows[Exploration]":
        """The settings for compiled functions."""
        return as_row(self)


class Exploring(Row):
    """Where an exploration stands."""

    corners: Floats = reals((4, 3), "mm", "the places p₁ that marker 1 visits in turn")
    seen: Floats = reals((4, 7), "mm, mm, mm, px, px, px, px", "[p₁, raw m₁ m₂] at the last visits")
    visits: int = whole("", "corners visited so far, over all rounds")
    start: int = whole("ns", "when it began")
    begun: bool = flag("whether there are corners to visit")
    no_room: bool = flag("whether the joint limits leave no room for them")
    done: bool = flag("whether there is an estimate to servo with")


@compiled
def begin(
    tour: Exploring, rcm: Rcm, q: Floats, now: int, least_room: float, x: Exploration
) -> None:
    """Plan the tour from the configuration q (3,), or note that the joint limits leave less than
    the share `least_room` of its volume."""
    full = x.radius**3 * volume(CORNERS)
    for shape in (CORNERS, MIRRORED):
        places = corners(rcm, q, x.radius, shape)
        if volume(places) > least_room * (1.0 - ROUNDING) * full:
            put(tour.corners, places)
            tour.begun, tour.visits, tour.start = True, 0, now
            return
    tour.no_room = True


@compiled
def corner(tour: Exploring) -> Floats:
    """The place (3,) mm to go to next."""
    return tour.corners[tour.visits % 4]


@compiled
def visit(tour: Exploring, p1: Floats, points: Floats) -> None:
    """Note what was seen at a corner: p1 (3,) mm and raw points (2, 2) px of one frame."""
    for i in range(3):
        put(tour.seen[i], tour.seen[i + 1])
    put(tour.seen[3][:3], p1)
    for i in range(4):
        tour.seen[3][3 + i] = points[i // 2, i % 2]
    tour.visits += 1


@compiled
def complete(tour: Exploring, J_hat: Floats, o_c: Floats, x: Exploration) -> bool:
    """Whether all corners were seen and Ĵ explains what was seen there."""
    toured = tour.visits >= 4 * x.rounds
    return toured and unexplained(tour.seen, J_hat, o_c) <= x.tolerance


@compiled
def overdue(tour: Exploring, now: int, x: Exploration) -> bool:
    """Whether the time allowed for a tour is used up."""
    return tour.begun and now - tour.start > x.max_time * 1e9
