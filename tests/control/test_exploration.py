"""The first motion: reachable corners that span space, inside the limits and near the start, and an
honest end.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import random_from, seeds
from rcmservo.control.exploration import (
    CORNER_TOLERANCE,
    CORNERS,
    Exploration,
    Exploring,
    arrived,
    begin,
    box,
    disagreement,
    face,
    overdue,
    span,
    towards,
)
from rcmservo.errors import BadInput
from rcmservo.geometry.kinematics import (
    JointLimits,
    PitchYawRcm,
    SphericalRcm,
    position,
    position_jacobian,
)
from rcmservo.numerics.structs import as_row
from rcmservo.safety.gate import Gate
from rcmservo.safety.thresholds import Thresholds

LEAST_ROOM = Thresholds.least_room
FASTEST = np.array(Gate.speed)
RCMS = [SphericalRcm(), PitchYawRcm(), PitchYawRcm(insertion_zero=-7.0)]
rcms = st.sampled_from(RCMS)


def somewhere(rcm, seed, margin=0.0):
    lower, upper = np.array(rcm.limits.lower), np.array(rcm.limits.upper)
    return random_from(seed).uniform(
        lower + margin * (upper - lower), upper - margin * (upper - lower)
    )


def begun(rcm, q, now=0, least_room=LEAST_ROOM, **choices):
    """A tour, or None where there is no room for one."""
    tour = Exploring.of()
    x = as_row(Exploration(**choices))[0]
    begin(tour.rows[0], rcm.rcm(), FASTEST, q, now, least_room, x)
    assert tour.begun != tour.no_room
    return tour if tour.begun else None


def later(tour, rcm, number, **choices):
    """The sides of round `number`, counted from 0."""
    rows = tour.rows.copy()
    rows["visits"] = number * len(CORNERS)
    box(rows[0], rcm.rcm(), FASTEST, 0.0, as_row(Exploration(**choices))[0])
    return Exploring(rows).sides


def corners(home, sides):
    return home + CORNERS * sides


def apart(rcm, places):
    """The longest way of marker 1 between any two of these joints, mm."""
    p = np.stack([position(rcm.rcm(), q) for q in places])
    return np.linalg.norm(p[:, None] - p[None], axis=2).max()


@given(rcms, seeds, st.integers(0, 6))
def test_every_rounds_corners_are_within_the_limits_and_marker_1_goes_no_further_than_the_reach(
    rcm, seed, number
):
    q, reach = somewhere(rcm, seed), Exploration.reach
    tour = begun(rcm, q)
    if tour is not None:
        there = corners(q, later(tour, rcm, number))
        assert np.all(there >= rcm.limits.lower) and np.all(there <= rcm.limits.upper)
        assert apart(rcm, there) < 1.15 * reach, "but for the bend of a joint's way"


@given(rcms, seeds)
def test_the_corners_of_a_tour_span_space(rcm, seed):
    """With every joint's side in all three of them: their volume is that of the sides, by 3."""
    q = somewhere(rcm, seed)
    tour = begun(rcm, q)
    if tour is not None:
        there = corners(q, tour.sides)
        volume = np.linalg.det(there[:3] - there[3])
        assert abs(volume) == pytest.approx(2.0 * abs(np.prod(tour.sides)))
        assert np.all(np.abs(tour.sides) >= LEAST_ROOM * np.abs(wanted(rcm, q)) * (1 - 1e-12))


def wanted(rcm, q, number=0, x=Exploration()):  # noqa: B008 frozen
    """The sides of a round where there is room."""
    sides = x.share * x.leg * FASTEST * x.growth**number
    return sides * min(x.reach / span(rcm.rcm(), q, sides), 1.0)


@given(rcms, seeds)
def test_far_from_limits_a_joint_goes_as_far_as_it_gets_in_a_leg_up_to_the_reach(rcm, seed):
    q = somewhere(rcm, seed, margin=0.3)
    tour = begun(rcm, q, now=5)
    assert tour is not None and tour.visits == 0 and tour.start == 5
    np.testing.assert_allclose(tour.sides, wanted(rcm, q))
    assert np.array_equal(tour.home, q)


@given(rcms, seeds)
def test_every_round_is_larger_until_the_reach_and_mirrored(rcm, seed):
    q = somewhere(rcm, seed, margin=0.35)
    tour = begun(rcm, q, reach=20.0)
    for number in range(1, 7):
        sides = later(tour, rcm, number, reach=20.0)
        size = wanted(rcm, q, number, Exploration(reach=20.0))
        np.testing.assert_allclose(sides, size * (-1.0) ** number)


@given(rcms, seeds)
def test_the_span_is_the_longest_way_of_a_corner_to_a_corner_by_the_derivative(rcm, seed):
    random, q = random_from(seed), somewhere(rcm, seed)
    sides = random.uniform(-1.0, 1.0, 3) * (0.1, 0.1, 10.0)
    steps = position_jacobian(rcm.rcm(), q) * np.abs(sides)
    pairs = (0, 1), (1, 2), (2, 0)
    longest = max(np.linalg.norm(np.abs(steps[:, pair]).sum(axis=1)) for pair in pairs)
    assert span(rcm.rcm(), q, sides) == pytest.approx(longest)
    p = corners(np.zeros(3), sides) @ position_jacobian(rcm.rcm(), q).T
    assert np.linalg.norm(p[:, None] - p[None], axis=2).max() <= longest * (1 + 1e-12)


def drive(rcm, q, visits, dt=0.01):
    """The joints at every corner visited, by an arm that does just what it is told; less where 3 s
    a round are not enough.
    """
    tour, x, there = begun(rcm, q), as_row(Exploration())[0], []
    for _ in range(round(3.0 / dt) * visits // len(CORNERS)):
        if tour is None or tour.visits == visits:
            break
        if arrived(tour.rows[0], q):
            there.append(q)
            tour.rows["visits"] += 1
            if tour.visits % len(CORNERS) == 0:
                box(tour.rows[0], rcm.rcm(), FASTEST, 0.0, x)
            face(tour.rows[0])
        q = q + towards(tour.rows[0], FASTEST, q, 0.0, x) * dt
        assert np.all(q >= rcm.limits.lower) and np.all(q <= rcm.limits.upper)
    return tour, there


@given(rcms, seeds)
def test_every_tour_can_be_driven_within_the_limits_and_every_round_ends_at_its_start(rcm, seed):
    q = somewhere(rcm, seed)
    tour, there = drive(rcm, q, visits=12)
    if tour is not None:
        assert tour.visits == 12
        largest = np.abs([later(tour, rcm, number) for number in range(3)]).max(axis=0)
        for home in there[3::4]:
            assert np.all(np.abs(home - q) <= CORNER_TOLERANCE * largest)


def test_a_tour_can_be_driven_from_a_spherical_start_near_half_a_turn_too():
    rcm = SphericalRcm()
    for theta in (0.5, 1.0):
        for side in (-1, 1):
            assert drive(rcm, np.array([theta, side * 3.0, 100.0]), visits=8)[0].visits == 8


def test_the_first_round_is_driven_in_less_than_a_second():
    tour, there = drive(PitchYawRcm(), np.array([0.1, 0.2, 100.0]), visits=4)
    assert len(there) == 4
    ways = np.abs(np.diff([tour.home, *there], axis=0)) / (Exploration.share * FASTEST)
    assert ways.max(axis=1).sum() < 1.0


@pytest.mark.parametrize("joint", range(3))
def test_without_room_in_one_joint_there_is_no_tour(joint):
    q = np.array([0.1, 0.2, 100.0])
    lower, upper = np.array([-1.0, -0.9, 50.0]), np.array([1.0, 0.9, 200.0])
    lower[joint], upper[joint] = q[joint] - 1e-3, q[joint] + 1e-3
    rcm = PitchYawRcm(JointLimits(tuple(lower), tuple(upper)))
    assert begun(rcm, q) is None


def test_how_much_room_a_tour_needs_is_a_threshold():
    rcm, q = PitchYawRcm(), np.array([0.1, 0.2, 100.0])
    found = [begun(rcm, q, least_room=share) is not None for share in (0.2, 1.0, 1.1)]
    assert found == [True, True, False]


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_next_to_a_limit_the_joint_goes_to_the_other_side_in_every_round(joint, end):
    rcm = PitchYawRcm()
    q, inside = np.array([0.1, 0.2, 100.0]), 1.0 if end == "lower" else -1.0
    q[joint] = getattr(rcm.limits, end)[joint]
    tour = begun(rcm, q)
    for number in range(6):
        assert later(tour, rcm, number)[joint] * inside > 0.0


def test_wherever_the_tool_stands_within_the_margins_there_is_room():
    for rcm in RCMS:
        assert all(begun(rcm, somewhere(rcm, seed)) is not None for seed in range(100))


def test_at_the_corner_itself_nothing_moves_and_far_from_it_the_slowest_joint_at_its_speed():
    tour = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]))
    x, corner = as_row(Exploration())[0], corners(tour.home, tour.sides)[0]
    assert not towards(tour.rows[0], FASTEST, corner, 0.0, x).any()
    rates = towards(tour.rows[0], FASTEST, corner - [1.0, -1.0, 50.0], 0.0, x)
    np.testing.assert_allclose(rates, Exploration.share * FASTEST * [1.0, -1.0, 1.0])


def test_a_corner_counts_as_visited_by_all_three_joints():
    tour = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]))
    corner = corners(tour.home, tour.sides)[0]
    for joint in range(3):
        for share, there in ((0.9, True), (1.1, False)):
            q = corner.copy()
            q[joint] += share * CORNER_TOLERANCE * tour.sides[joint]
            assert arrived(tour.rows[0], q) == there
    assert not arrived(tour.rows[0], np.full(3, np.nan))


@given(seeds, st.floats(0.0, 2.0))
def test_an_estimate_disagrees_by_the_share_that_it_is_off(seed, share):
    random = random_from(seed)
    J, wrong = random.standard_normal((2, 3, 3))
    J_hat = J + share * wrong * np.linalg.norm(J) / np.linalg.norm(wrong)
    assert disagreement(J_hat, J) == pytest.approx(share, abs=1e-9)


def test_no_estimate_agrees_with_nothing():
    assert disagreement(np.ones((3, 3)), np.zeros((3, 3))) == np.inf
    assert disagreement(np.zeros((3, 3)), np.ones((3, 3))) == 1.0
    assert not disagreement(np.full((3, 3), np.nan), np.ones((3, 3))) <= 1e9


def test_a_tour_is_overdue_just_after_its_time():
    tour = begun(PitchYawRcm(), np.array([0.1, 0.2, 100.0]), now=3_000_000_000)
    x = as_row(Exploration(max_time=10.0))[0]
    assert not overdue(tour.rows[0], 13_000_000_000, x)
    assert overdue(tour.rows[0], 13_000_000_001, x)
    assert not overdue(Exploring.of().rows[0], 13_000_000_001, x)


@pytest.mark.parametrize(
    "name", ["leg", "share", "reach", "growth", "uncertainty", "tolerance", "legs", "max_time"]
)
@pytest.mark.parametrize("value", [0, -1, 1e300])
def test_settings_that_cannot_work_are_refused_by_name(name, value):
    if value == 1e300 and name not in ("share", "growth", "legs"):
        value = np.inf
    with pytest.raises(BadInput, match=name):
        Exploration(**{name: value})
