"""Exploration: the first motion, which visits the corners of small tetrahedra in joint space.

The initial estimates are zero: neither the projection parameters â nor Ĵ can be inverted. Coplanar
marker positions leave the projection fit undetermined (rank 8 of 9), so exploration moves yaw,
pitch and insertion together. Four alternate corners of a box in joint space form a tetrahedron. The
start is one of them, and the box extends to the side where the joints have room. Each joint moves
little, and a round ends at the start. The next round is mirrored and larger.

After the minimal number of corners, the next corner minimises the expected error of the path to the
target (exploration_planning.py). Exploration ends when this error is below the fraction
`uncertainty` of the path, and Ĵ agrees to `tolerance` with the fitted projection (camera_fit.py).
If the fit contradicts the pixels of the target at the joints of teaching, up to four more corners
must confirm it. After its maximal time the exploration reports that it has failed. The estimate is
updated further during servoing.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from rcmservo.constraints import FRACTION, Checked, between, positive
from rcmservo.control.drive_response import ResponseMeasurement, start_response_measurement
from rcmservo.geometry.kinematics import Point, RcmStruct, compute_position_jacobian
from rcmservo.interfaces import Floats
from rcmservo.numerics.jit import compiled
from rcmservo.numerics.small_linalg import compute_norm, copy_into, subtract
from rcmservo.numerics.structs import flag, real, reals, whole

CORNERS = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
"""Corners of a box with sides of length 1 in the order of the visits; the last is the start."""

LIMIT_MARGIN = 0.02
"""Fraction of each joint's range between a corner and the joint limits."""

CORNER_TOLERANCE = 0.15
"""Largest deviation of a joint from a visited corner, as a fraction of the box's side."""

CONFIRMING_CORNERS = 4
"""Corners after the minimal number that must confirm a contradiction between target and fit."""

MIN_LEG_LENGTH_MM = 1e-9
"""Smallest length (mm) of a leg that the maximal length is divided by."""

MIN_BRAKING_TIME_S = 0.03
"""Time (s) before a corner at which the joints slow down.

It is longer if the drives lag by more, as the joints would otherwise overshoot the corner.
"""


@dataclass(frozen=True)
class Exploration(Checked, section="exploration"):
    """Exploratory motion in joint space before servoing, while the estimate is still unknown.

    The tool visits corners of a small box in joint space until the direction to the target is
    known. The start and the first three corners form a tetrahedron. An instance is passed as the
    argument `exploration` of `Servo`.

    Parameters
    ----------
    leg_time : float
        Time from corner to corner in the first round, s, positive.
    speed_scale : float
        Fraction of every joint's maximal speed at which it moves, above 0 and at most 1. The joints
        are slower where a marker or the tip would exceed `max_speed` of `SaturatedController`.
    max_leg_length : float
        Maximal distance of marker 1 from corner to corner, mm, positive.
    growth : float
        Ratio of the size of a round to that of the previous round, from 1 to 10.
    uncertainty : float
        Largest error of the estimated path to the target at the start of servoing, one standard
        deviation as a fraction of the path's length (1 is 100 %), positive.
    tolerance : float
        Largest norm of the difference between Ĵ and the Jacobian of the projection fit, as a
        fraction of the norm of the latter, positive.
    min_corners : int
        Minimal number of corners to visit, from 1 to 1000.
    max_time : float
        Time after which exploration fails, s, positive. A `max_speed` below 2 mm/s needs more than
        the default.

    Raises
    ------
    BadInput
        If a parameter is outside its range.

    Notes
    -----
    Exploration fails with the cause NOT_EXPLORED after `max_time`, and with NO_ROOM if the joint
    limits leave no room for the box.

    A round visits four alternate corners of the box, which form a tetrahedron; the last is the
    start. The next round is mirrored and larger by `growth`. Once `min_corners` are visited, the
    next corner is instead one of 27 points: each joint at the start, or one side of the box up or
    down. It is the one, within the joint limits and `max_leg_length`, with the least expected error
    of the path to the target, in mm:

        σ √tr(T N⁻¹ Tᵀ),    N = Σ DᵀD + N₀,    T = H⁺(D(p₁ + path) − D(p₁))

    σ (px) is the noise of a pixel coordinate, and D = ∂m/∂θ (4, 11) the derivative of both markers
    by the eleven parameters θ of the projection fit, the eight of A (px) and the three of g that
    `DltEstimator` describes. N (11, 11) sums over all frames so far and on the way to that corner.
    σ² (px²) is the mean squared residual of the fit, (0.5 px)² at first. The prior N₀ is diagonal,
    with 1e-6 σ² for A and σ² for g. H = ∂m/∂p₁ (4, 3) is in px/mm. The path H⁺(m_d − m) (3,) mm
    leads from the present markers m to those of the target m_d; beyond 10 mm its error is
    extrapolated in proportion.

    Exploration ends with an estimate once `min_corners` are visited and this error, for the frames
    so far, is at most the fraction `uncertainty` of the path's length, or 0.5 mm. In addition the
    fit must be plausible for a camera, by ``max_residual_px`` and ``min_camera_distance`` of
    `Thresholds`, and have marker 1 nearer the RCM. With an estimator that uses eq. (16), the
    uncertainty of o_c must be at most half of the limit of `ImagedRcm`, and Ĵ must
    agree with the fit to `tolerance`.

    References
    ----------
    Section III-B of the paper for the excitation that 6 independent observations need (Proposition
    1). The corners and the criterion are this project's own.
    """

    name = "tour"

    leg_time: Annotated[float, positive("time in s")] = 0.15
    speed_scale: Annotated[float, FRACTION] = 0.2
    max_leg_length: Annotated[float, positive("length in mm")] = 8.0
    growth: Annotated[float, between(1.0, 10.0, "a factor")] = 1.5
    uncertainty: Annotated[float, positive("fraction")] = 1.0
    tolerance: Annotated[float, positive("fraction")] = 0.3
    min_corners: Annotated[int, between(1, 1000, "a whole number")] = 3
    max_time: Annotated[float, positive("time in s")] = 10.0


class ExplorationState(ResponseMeasurement):
    """State of an exploration, with the measurement of the drives' gains and lag during it."""

    start_joints: Floats = reals(3, "rad, rad, mm", "joints at the start")
    sides: Floats = reals(3, "rad, rad, mm", "signed sides of this round's box")
    next_corner: Floats = reals(3, "rad, rad, mm", "joints at the next corner")
    visited_corners: int = whole("", "number of visited corners in all rounds")
    start_time: int = whole("ns", "start time")
    has_begun: bool = flag("whether corners are planned")
    has_no_room: bool = flag("whether the joint limits leave no room for corners")
    fit_is_known: bool = flag("whether the projection fit suffices, though Ĵ may not yet")
    is_conclusive: bool = flag("whether the corners suffice to contradict the target")
    disagreement: float = real("", "difference of Ĵ from the fit, as a fraction; NaN without a fit")
    is_done: bool = flag("whether the estimate is usable for servoing")


@compiled
def start_exploration(
    state: ExplorationState,
    rcm: RcmStruct,
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
    copy_into(state.start_joints, q)
    state.visited_corners, state.start_time = 0, now
    state.fit_is_known, state.is_conclusive, state.disagreement = False, False, np.nan
    start_response_measurement(state)
    state.has_begun = set_round(state, rcm, max_rates, min_room, settings)
    state.has_no_room = not state.has_begun
    set_next_corner(state)


@compiled
def set_next_corner(state: ExplorationState) -> None:
    """Set the next corner to the next one of `CORNERS`."""
    corner = CORNERS[state.visited_corners % len(CORNERS)]
    for i in range(3):
        state.next_corner[i] = state.start_joints[i] + corner[i] * state.sides[i]


@compiled
def set_round(
    state: ExplorationState,
    rcm: RcmStruct,
    max_rates: Floats | Point,
    min_room: float,
    settings: Exploration,
) -> bool:
    """Set the sides of the next round; return whether there is room for them."""
    round_index, full_sides, has_room = state.visited_corners // len(CORNERS), np.empty(3), True
    for i in range(3):
        reach = settings.speed_scale * settings.leg_time * max_rates[i]
        full_sides[i] = reach * settings.growth**round_index
    leg_length = max(compute_max_leg_length(rcm, state.start_joints, full_sides), MIN_LEG_LENGTH_MM)
    factor = min(settings.max_leg_length / leg_length, 1.0)
    for i in range(3):
        side, margin = factor * full_sides[i], LIMIT_MARGIN * (rcm.upper[i] - rcm.lower[i])
        up = max(rcm.upper[i] - margin - state.start_joints[i], 0.0)
        down = max(state.start_joints[i] - rcm.lower[i] - margin, 0.0)
        preferred, opposite = (up, down) if round_index % 2 == 0 else (down, up)
        is_reversed = preferred < side and opposite > preferred
        sign = 1.0 if is_reversed == (round_index % 2 == 1) else -1.0
        side_length = min(max(preferred, opposite) if is_reversed else preferred, side)
        state.sides[i] = sign * side_length
        has_room = has_room and side_length >= min_room * side
    return has_room


@compiled
def compute_max_leg_length(rcm: RcmStruct, q: Floats, sides: Floats) -> float:
    """Return the longest path (mm) of marker 1 from corner to corner of a box in joint space."""
    jacobian, longest_mm = compute_position_jacobian(rcm, q), 0.0
    for i in range(3):
        for j in range(i):
            squared = 0.0
            for k in range(3):
                step_i, step_j = jacobian[k, i] * sides[i], jacobian[k, j] * sides[j]
                squared += (abs(step_i) + abs(step_j)) ** 2
            longest_mm = max(longest_mm, np.sqrt(squared))
    return longest_mm


@compiled
def compute_rates_to_corner(
    state: ExplorationState, max_rates: Floats | Point, q: Floats, lag: float, settings: Exploration
) -> Floats:
    """Return the joint rates (3,) to the next corner, for drives with the given lag in s."""
    rates, braking_time = np.empty(3), max(lag, MIN_BRAKING_TIME_S)
    for i in range(3):
        speed = settings.speed_scale * max_rates[i]
        distance = state.next_corner[i] - q[i]
        rates[i] = min(max(distance / braking_time, -speed), speed)
    return rates


@compiled
def is_at_corner(state: ExplorationState, corner: Floats, q: Floats) -> bool:
    """Return whether the joints q (3,) are at a `corner` (3,) of this round's box."""
    is_reached = True
    for i in range(3):
        is_reached = is_reached and abs(corner[i] - q[i]) <= CORNER_TOLERANCE * abs(state.sides[i])
    return is_reached


@compiled
def compute_relative_difference(J_hat: Floats, J: Floats) -> float:
    """Return the norm of Ĵ − J as a fraction of the norm of J (3, 3), both with scaled rows."""
    norm = compute_norm(J)
    return compute_norm(subtract(J_hat.ravel(), J.ravel())) / norm if norm > 0.0 else np.inf


@compiled
def is_overdue(state: ExplorationState, now: int, settings: Exploration) -> bool:
    """Return whether the exploration has used up its maximal time."""
    return state.has_begun and now - state.start_time > settings.max_time * 1e9
