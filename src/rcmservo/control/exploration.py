"""The first motion, from nothing: the joints visit the corners of a small tetrahedron, and then
others of that size, until the estimate is known well enough.

Neither â = 0 nor Ĵ = 0 can be inverted, and coplanar positions leave the projection undetermined
(rank 8), so the policy asks for yaw, pitch and insertion together. The corners are alternate ones
of a box in joint space with the start at one corner, on the side that the joint limits leave free;
so no joint has to go far, wherever the tool stands, and a round ends at the start. The next round
is mirrored and larger.

Once the minimum number of corners is visited, the next corner is chosen for its information on the
path to the target (exploration_planning.py). Exploration ends as soon as the direction to the
target is known to `uncertainty` and Ĵ agrees to `tolerance` with the fitted projection
(projection_fit.py); after the time allowed it reports that this is not the case. The estimate is
updated further while the tool servoes.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import FRACTION, Checked, between, positive
from rcmservo.control.drive_lag import DriveLag, begin_lag
from rcmservo.geometry.kinematics import Point, Rcm, position_jacobian
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import length, minus, put
from rcmservo.numerics.structs import flag, reals, whole

CORNERS = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
"""Of a box of sides 1, in the order of the visits; the last is the start."""

LIMIT_MARGIN = 0.02
"""Share of each joint's range that the corners keep from its ends."""

NEAR = 0.15
"""Share of a box's side by which a joint may be off a corner that counts as visited."""

BRAKE = 0.03
"""s before a corner at which the joints begin to go slower; longer where the drives lag by more, or
they would swing about it."""


@dataclass(frozen=True)
class Exploration(Checked, section="exploration"):
    """How the tool moves while nothing is known yet.

    Parameters
    ----------
    leg : float
        Time from corner to corner in the first round, s.
    share : float
        Share of every joint's greatest speed at which it moves.
    reach : float
        How far marker 1 goes from corner to corner at most, mm.
    growth : float
        How many times as large every round is as the one before.
    uncertainty : float
        Share of the way to the target by which the estimate may mistake it as servoing begins, one
        standard deviation.
    tolerance : float
        Share by which Ĵ may differ from what the camera should see.
    legs : int
        Least number of corners to visit.
    max_time : float
        Time after which exploration is given up, s.
    """

    name = "tour"

    leg: Annotated[float, positive("time in s")] = 0.15
    share: Annotated[float, FRACTION] = 0.2
    reach: Annotated[float, positive("length in mm")] = 8.0
    growth: Annotated[float, between(1.0, 10.0, "a factor")] = 1.5
    uncertainty: Annotated[float, positive("share")] = 1.0
    tolerance: Annotated[float, positive("share")] = 0.3
    legs: Annotated[int, between(1, 1000, "a whole number")] = 3
    max_time: Annotated[float, positive("time in s")] = 10.0


class Exploring(DriveLag):
    """Where an exploration stands."""

    home: Floats = reals(3, "rad, rad, mm", "the joints at its start")
    sides: Floats = reals(3, "rad, rad, mm", "of this round's box, with their signs")
    goal: Floats = reals(3, "rad, rad, mm", "the joints at the next corner")
    visits: int = whole("", "corners visited so far, over all rounds")
    start: int = whole("ns", "when it began")
    begun: bool = flag("whether there are corners to visit")
    no_room: bool = flag("whether the joint limits leave no room for them")
    done: bool = flag("whether there is an estimate to servo with")


@compiled
def begin(
    tour: Exploring,
    rcm: Rcm,
    fastest: Floats | Point,
    q: Floats,
    now: int,
    least: float,
    x: Exploration,
) -> None:
    """Plan the first round from the joints q (3,), or note that the limits leave a joint less than
    the share `least` of its side. The joints move at `fastest` (3,) at most.
    """
    put(tour.home, q)
    tour.visits, tour.start = 0, now
    begin_lag(tour)
    tour.begun = box(tour, rcm, fastest, least, x)
    tour.no_room = not tour.begun
    face(tour)


@compiled
def face(tour: Exploring) -> None:
    """Make the round's own corner the next one."""
    corner = CORNERS[tour.visits % len(CORNERS)]
    for i in range(3):
        tour.goal[i] = tour.home[i] + corner[i] * tour.sides[i]


@compiled
def box(tour: Exploring, rcm: Rcm, fastest: Floats | Point, least: float, x: Exploration) -> bool:
    """The sides of the next round; whether there is room for them."""
    number, wanted, room = tour.visits // len(CORNERS), np.empty(3), True
    for i in range(3):
        wanted[i] = x.share * x.leg * fastest[i] * x.growth**number
    shorter = min(x.reach / max(span(rcm, tour.home, wanted), 1e-9), 1.0)
    for i in range(3):
        side, margin = shorter * wanted[i], LIMIT_MARGIN * (rcm.upper[i] - rcm.lower[i])
        up = max(rcm.upper[i] - margin - tour.home[i], 0.0)
        down = max(tour.home[i] - rcm.lower[i] - margin, 0.0)
        first, second = (up, down) if number % 2 == 0 else (down, up)
        other = first < side and second > first
        sign = 1.0 if other == (number % 2 == 1) else -1.0
        free = min(max(first, second) if other else first, side)
        tour.sides[i] = sign * free
        room = room and free >= least * side
    return room


@compiled
def span(rcm: Rcm, q: Floats, sides: Floats) -> float:
    """Mm that marker 1 moves at most from corner to corner of a box in joint space."""
    jacobian, longest = position_jacobian(rcm, q), 0.0
    for i in range(3):
        for j in range(i):
            squared = 0.0
            for k in range(3):
                one, other = jacobian[k, i] * sides[i], jacobian[k, j] * sides[j]
                squared += (abs(one) + abs(other)) ** 2
            longest = max(longest, np.sqrt(squared))
    return longest


@compiled
def towards(
    tour: Exploring, fastest: Floats | Point, q: Floats, lag: float, x: Exploration
) -> Floats:
    """Joint rates (3,) towards the next corner, by drives that lag by so many s."""
    rates, brake = np.empty(3), max(lag, BRAKE)
    for i in range(3):
        speed = x.share * fastest[i]
        way = tour.goal[i] - q[i]
        rates[i] = min(max(way / brake, -speed), speed)
    return rates


@compiled
def arrived(tour: Exploring, q: Floats) -> bool:
    """Whether the joints q (3,) are at the next corner."""
    return at(tour.goal, tour.sides, q)


@compiled
def at(corner: Floats, sides: Floats, q: Floats) -> bool:
    """Whether the joints q (3,) are at a corner (3,) of a box with these `sides` (3,)."""
    there = True
    for i in range(3):
        there = there and abs(corner[i] - q[i]) <= NEAR * abs(sides[i])
    return there


@compiled
def disagreement(J_hat: Floats, J: Floats) -> float:
    """Share of J (3, 3), scaled, by which Ĵ differs from it."""
    size = length(J)
    return length(minus(J_hat.ravel(), J.ravel())) / size if size > 0.0 else np.inf


@compiled
def overdue(tour: Exploring, now: int, x: Exploration) -> bool:
    """Whether the time allowed for a tour is used up."""
    return tour.begun and now - tour.start > x.max_time * 1e9
