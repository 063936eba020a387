"""Exploration: the first motion, which visits the corners of small tetrahedra in joint space.

Neither â = 0 nor Ĵ = 0 can be inverted, and coplanar positions leave the projection undetermined
(rank 8). Exploration therefore moves yaw, pitch and insertion together. The corners are alternate
corners of a box in joint space, with the start at one corner, on the side that the joint limits
leave free. No joint has to move far from any start, and a round ends at the start. The next round
is mirrored and larger.

After the minimal number of corners, the next corner is chosen for its information on the path to
the target (exploration_planning.py). Exploration ends when the direction to the target is known to
`uncertainty`, and Ĵ agrees to `tolerance` with the projection fit (projection_fit.py). After its
maximal time it reports that it has failed. The estimate is updated further during servoing.
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
"""Corners of a box with sides of length 1 in the order of the visits; the last is the start."""

LIMIT_MARGIN = 0.02
"""Fraction of each joint's range between a corner and the joint limits."""

CORNER_TOLERANCE = 0.15
"""Largest deviation of a joint from a visited corner, as a fraction of the box's side."""

MIN_BRAKING_TIME_S = 0.03
"""Time (s) before a corner at which the joints slow down.

It is longer if the drives lag by more, as the joints would otherwise overshoot the corner.
"""


@dataclass(frozen=True)
class Exploration(Checked, section="exploration"):
    """Exploratory motion in joint space before servoing, while the estimate is still unknown.

    The tool visits corners of small tetrahedra until the direction to the target is known. The next
    corner minimises the expected error of the path to the target.

    Parameters
    ----------
    leg : float
        Time from corner to corner in the first round, s.
    share : float
        Fraction of every joint's maximal speed at which it moves.
    reach : float
        Maximal distance of marker 1 from corner to corner, mm.
    growth : float
        Ratio of the size of a round to that of the previous round.
    uncertainty : float
        Largest error of the estimated path to the target at the start of servoing, as a fraction of
        its length, one standard deviation.
    tolerance : float
        Largest difference between Ĵ and the projection fit, as a fraction.
    legs : int
        Minimal number of corners to visit.
    max_time : float
        Time after which exploration fails, s.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    Exploration fails with the cause NOT_EXPLORED after `max_time`, and with NO_ROOM if the joint
    limits leave no room for a box.

    References
    ----------
    Section III-B of the paper for the excitation that 6 independent observations need (Proposition
    1).
    """

    name = "tour"

    leg: Annotated[float, positive("time in s")] = 0.15
    share: Annotated[float, FRACTION] = 0.2
    reach: Annotated[float, positive("length in mm")] = 8.0
    growth: Annotated[float, between(1.0, 10.0, "a factor")] = 1.5
    uncertainty: Annotated[float, positive("fraction")] = 1.0
    tolerance: Annotated[float, positive("fraction")] = 0.3
    legs: Annotated[int, between(1, 1000, "a whole number")] = 3
    max_time: Annotated[float, positive("time in s")] = 10.0


class Exploring(DriveLag):
    """State of an exploration."""

    home: Floats = reals(3, "rad, rad, mm", "joints at the start")
    sides: Floats = reals(3, "rad, rad, mm", "signed sides of this round's box")
    goal: Floats = reals(3, "rad, rad, mm", "joints at the next corner")
    visits: int = whole("", "number of visited corners in all rounds")
    start: int = whole("ns", "start time")
    begun: bool = flag("whether corners are planned")
    no_room: bool = flag("whether the joint limits leave no room for corners")
    done: bool = flag("whether the estimate is usable for servoing")


@compiled
def begin(
    state: Exploring,
    rcm: Rcm,
    max_rates: Floats | Point,
    q: Floats,
    now: int,
    min_room: float,
    settings: Exploration,
) -> None:
    """Plan the first round from the joints q (3,) at the time `now` in ns.

    There is no room if the limits leave a joint less than the fraction `min_room` of its side.
    `max_rates` (3,) are the maximal joint rates.
    """
    put(state.home, q)
    state.visits, state.start = 0, now
    begin_lag(state)
    state.begun = box(state, rcm, max_rates, min_room, settings)
    state.no_room = not state.begun
    face(state)


@compiled
def face(state: Exploring) -> None:
    """Set the next corner to that of the round's own order."""
    corner = CORNERS[state.visits % len(CORNERS)]
    for i in range(3):
        state.goal[i] = state.home[i] + corner[i] * state.sides[i]


@compiled
def box(
    state: Exploring, rcm: Rcm, max_rates: Floats | Point, min_room: float, settings: Exploration
) -> bool:
    """Set the sides of the next round; return whether there is room for them."""
    round_index, full_sides, has_room = state.visits // len(CORNERS), np.empty(3), True
    for i in range(3):
        full_sides[i] = settings.share * settings.leg * max_rates[i] * settings.growth**round_index
    factor = min(settings.reach / max(span(rcm, state.home, full_sides), 1e-9), 1.0)
    for i in range(3):
        side, margin = factor * full_sides[i], LIMIT_MARGIN * (rcm.upper[i] - rcm.lower[i])
        up = max(rcm.upper[i] - margin - state.home[i], 0.0)
        down = max(state.home[i] - rcm.lower[i] - margin, 0.0)
        preferred, opposite = (up, down) if round_index % 2 == 0 else (down, up)
        is_reversed = preferred < side and opposite > preferred
        sign = 1.0 if is_reversed == (round_index % 2 == 1) else -1.0
        side_length = min(max(preferred, opposite) if is_reversed else preferred, side)
        state.sides[i] = sign * side_length
        has_room = has_room and side_length >= min_room * side
    return has_room


@compiled
def span(rcm: Rcm, q: Floats, sides: Floats) -> float:
    """Return the longest path (mm) of marker 1 from corner to corner of a box in joint space."""
    jacobian, longest = position_jacobian(rcm, q), 0.0
    for i in range(3):
        for j in range(i):
            squared = 0.0
            for k in range(3):
                step_i, step_j = jacobian[k, i] * sides[i], jacobian[k, j] * sides[j]
                squared += (abs(step_i) + abs(step_j)) ** 2
            longest = max(longest, np.sqrt(squared))
    return longest


@compiled
def towards(
    state: Exploring, max_rates: Floats | Point, q: Floats, lag: float, settings: Exploration
) -> Floats:
    """Return the joint rates (3,) to the next corner, for drives with the given lag in s."""
    rates, braking_time = np.empty(3), max(lag, MIN_BRAKING_TIME_S)
    for i in range(3):
        speed = settings.share * max_rates[i]
        distance = state.goal[i] - q[i]
        rates[i] = min(max(distance / braking_time, -speed), speed)
    return rates


@compiled
def arrived(state: Exploring, q: Floats) -> bool:
    """Return whether the joints q (3,) are at the next corner."""
    return is_at_corner(state.goal, state.sides, q)


@compiled
def is_at_corner(corner: Floats, sides: Floats, q: Floats) -> bool:
    """Return whether the joints q (3,) are at a corner (3,) of a box with these `sides` (3,)."""
    is_at = True
    for i in range(3):
        is_at = is_at and abs(corner[i] - q[i]) <= CORNER_TOLERANCE * abs(sides[i])
    return is_at


@compiled
def disagreement(J_hat: Floats, J: Floats) -> float:
    """Return the norm of Ĵ − J as a fraction of the norm of J (3, 3), both scaled."""
    size = length(J)
    return length(minus(J_hat.ravel(), J.ravel())) / size if size > 0.0 else np.inf


@compiled
def overdue(state: Exploring, now: int, settings: Exploration) -> bool:
    """Return whether the exploration has used up its maximal time."""
    return state.begun and now - state.start > settings.max_time * 1e9
